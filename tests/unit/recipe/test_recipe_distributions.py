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


PINNED: list[tuple[dict[str, Any], list[Any]]] = [
    ({"uniform": [18, 30]}, [19.243487323175156, 23.5607339630299, 29.62519386390162]),
    ({"normal": [3, 0.5]}, [3.6305846079724686, 3.0459427614575367, 2.0685192722091985]),
    ({"normal": {"mean": 0, "sd": 1, "low": 4, "high": 5}}, [4.025567413999236, 4.143157904591661, 4.705388793051215]),
    (
        {"normal": {"mean": 0, "sd": 1, "low": -5, "high": -4}},
        [-4.025567413999236, -4.143157904591661, -4.705388793051215],
    ),
    ({"lognormal": [20, 0.3]}, [29.197498515800266, 20.55898209634073, 11.436887038228742]),
    ({"integers": [-2, 300]}, [251, 123, 177]),
    ({"choice": ["a", "b", "c", 4]}, [4, "b", "c"]),
]


@pytest.mark.parametrize(("written", "values"), PINNED, ids=str)
def test_draws_stay_as_they_are(written: dict[str, Any], values: list[Any]) -> None:
    distribution = parse_distribution(written)
    assert [distribution.draw(child_rng(11, "recipe", i, "a.b")) for i in range(3)] == values


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ({"uniform": [18, 30]}, stats.uniform(18, 12)),
        ({"normal": [3, 0.5]}, stats.norm(3, 0.5)),
        ({"normal": {"mean": 0, "sd": 1, "low": 4, "high": 5}}, stats.truncnorm(4, 5)),
        ({"normal": {"mean": 0, "sd": 1, "low": -5, "high": -4}}, stats.truncnorm(-5, -4)),
        ({"normal": {"mean": 0, "sd": 1, "low": -1, "high": 2}}, stats.truncnorm(-1, 2)),
        ({"lognormal": [20, 0.3]}, stats.lognorm(0.3, scale=20)),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_quantiles_are_inverse_to_the_distribution_function(written: dict[str, Any], expected: Any) -> None:
    distribution = parse_distribution(written)
    u = np.array([1e-9, 0.01, 0.2, 0.5, 0.77, 0.999])
    values = np.array([distribution.quantile(one) for one in u.tolist()])
    assert values == pytest.approx(expected.ppf(u), rel=1e-9)
    for end in (0.0, 1.0 - 2.0**-53):
        value = distribution.quantile(end)
        assert np.isfinite(value)  # type: ignore[arg-type]
        assert expected.support()[0] <= value <= expected.support()[1]  # type: ignore[operator]


@pytest.mark.parametrize(
    ("written", "values"),
    [
        ({"integers": [-2, 1]}, [-2, -2, -1, -1, 0, 0, 1, 1]),
        ({"choice": ["a", "b"]}, ["a"] * 4 + ["b"] * 4),
        ({"choice": {"values": ["a", "b", "c", "d"], "weights": [5, 0, 1, 2]}}, ["a"] * 5 + ["c", "d", "d"]),
        ({"choice": [{"a": 1}, 3]}, [0] * 4 + [1] * 4),  # numbers of the entries
        ({"sequence": [1, 2, 3, 4]}, [1, 1, 2, 2, 3, 3, 4, 4]),
    ],
    ids=str,
)
def test_quantiles_of_what_is_counted(written: dict[str, Any], values: list[Any]) -> None:
    distribution = parse_distribution(written)
    found = [distribution.quantile(n / 8) for n in range(8)]
    assert found == values
    assert distribution.quantile(1.0 - 2.0**-53) == values[-1]


def test_draws_of_a_choice_follow_its_weights() -> None:
    found = list(draws({"choice": {"values": ["a", "b", "c", "d"], "weights": [3, 1, 0, 1]}}))
    assert set(found) == {"a", "b", "d"}
    assert stats.chisquare([found.count(one) for one in "abd"], [N * 0.6, N * 0.2, N * 0.2]).pvalue > 1e-3


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
        {"sequence": [{"a": 1}]},
        {"choice": {"noise": 0.7, "none": 0.3}},
        {"choice": {"values": [1, 2], "weights": [1]}},
        {"choice": {"values": [1, 2], "weights": [1, -1]}},
        {"choice": {"values": [1, 2], "weights": [0, 0]}},
        {"choice": {"values": [1, {"a": 2}], "weights": [1, 0]}},
        {"choice": [float("inf")]},
    ],
    ids=str,
)
def test_bad_parameters(written: dict[str, Any]) -> None:
    with pytest.raises(BadDistributionError):
        parse_distribution(written)
