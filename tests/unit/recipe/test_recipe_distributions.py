from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from forestgen.core.randomness import child_rng
from forestgen.recipe.distributions import BadDistributionError, is_distribution, parse_distribution

N = 4000


def draws(written: dict[str, Any]) -> np.ndarray[Any, Any]:
    distribution = parse_distribution(written)
    # One stream a draw, as recipes draw: this also tests that the streams are independent.
    return np.array([distribution.draw(child_rng(11, "recipe", i, "a.b")) for i in range(N)])


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ({"uniform": [18, 30]}, stats.uniform(18, 12)),
        ({"normal": [3, 0.5]}, stats.norm(3, 0.5)),
        ({"normal": {"mean": 3, "sd": 2, "low": 2}}, stats.truncnorm(-0.5, np.inf, 3, 2)),
        ({"normal": {"mean": 3, "sd": 2, "high": 2}}, stats.truncnorm(-np.inf, -0.5, 3, 2)),
        ({"normal": {"mean": 0, "sd": 1, "low": 4, "high": 5}}, stats.truncnorm(4, 5)),
        ({"normal": {"mean": 0, "sd": 1, "low": -5, "high": -4}}, stats.truncnorm(-5, -4)),
        ({"normal": {"mean": 0, "sd": 1, "low": -1, "high": 2}}, stats.truncnorm(-1, 2)),
        ({"lognormal": [20, 0.3]}, stats.lognorm(0.3, scale=20)),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_continuous_draws_follow_their_distribution(written: dict[str, Any], expected: Any) -> None:
    assert stats.kstest(draws(written), expected.cdf).pvalue > 1e-3


def test_truncated_lognormal() -> None:
    values = draws({"lognormal": {"median": 20, "sigma": 0.5, "low": 15, "high": 40}})
    whole = stats.lognorm(0.5, scale=20)
    low, high = whole.cdf([15, 40])
    assert values.min() >= 15
    assert values.max() <= 40
    assert stats.kstest(values, lambda x: (whole.cdf(x) - low) / (high - low)).pvalue > 1e-3


@pytest.mark.parametrize(
    ("written", "values"),
    [({"integers": [-2, 3]}, [-2, -1, 0, 1, 2, 3]), ({"choice": ["a", "b", "c"]}, ["a", "b", "c"])],
    ids=str,
)
def test_discrete_draws_are_equally_likely(written: dict[str, Any], values: list[Any]) -> None:
    found = list(draws(written))
    counts = [found.count(value) for value in values]
    assert sum(counts) == N
    assert stats.chisquare(counts).pvalue > 1e-3


def test_streams_of_two_keys_are_uncorrelated() -> None:
    distribution = parse_distribution({"uniform": [0, 1]})
    a, b = ([distribution.draw(child_rng(3, "recipe", i, key)) for i in range(N)] for key in ("a", "b"))
    assert stats.spearmanr(a, b).pvalue > 1e-3
    assert stats.spearmanr(a[1:], a[:-1]).pvalue > 1e-3


def test_extremes() -> None:
    assert parse_distribution({"uniform": [1, 2]}).extremes() == (1, 2)
    assert parse_distribution({"normal": [1, 2]}).extremes() == (1,)
    assert parse_distribution({"normal": {"mean": 1, "sd": 2, "low": 3, "high": 4}}).extremes() == (3, 3, 4)
    assert parse_distribution({"choice": ["a", None, True]}).extremes() == ("a", None, True)


def test_what_is_a_distribution() -> None:
    assert is_distribution({"choice": 1})
    assert not is_distribution({"uniform": [1, 2], "low": 1})
    assert not is_distribution([1, 2])


@pytest.mark.parametrize(
    "written",
    [
        {"uniform": 3},
        {"uniform": ["a", "b"]},
        {"uniform": [True, 2]},
        {"uniform": [-1e308, 1e308]},
        {"integers": [1.5, 2]},
        {"integers": [0, 2**63]},
        {"normal": {"mean": 1}},
        {"normal": {"mean": 1, "sd": 1, "lo": 1}},
        {"normal": {"mean": 1, "sd": "x"}},
        {"normal": {"mean": 1, "sd": 1, "low": 2, "high": 2}},
        {"lognormal": {"median": 1, "sigma": 1, "high": -1}},
        {"choice": [{"a": 1}]},
    ],
    ids=str,
)
def test_bad_parameters(written: dict[str, Any]) -> None:
    with pytest.raises(BadDistributionError):
        parse_distribution(written)
