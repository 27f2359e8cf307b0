from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import LoadedRecipe, dump_yaml, load_recipe
from forestgen.recipe.map_files import recipe_hash
from support.error_messages import raises_error

Write = Callable[..., Path]
METHODS = ["independent", "latin_hypercube", "sobol", "halton"]
EVEN = METHODS[1:]
TEXT = """\
forestgen: 1
seed: 5
dataset: {splits: {train: 1}}
species: {oak: ./oak.yaml}
community: {model: lattice, steps: {integers: [10, 19]}}
plants: {season: {choice: [spring, summer, autumn, dry]}}
site: {altitude_m: {normal: {mean: 300, sd: 200, low: 0}}}
sky:
  turbidity: {uniform: [2, 6]}
  visibility_m: {lognormal: {median: 20000, sigma: 0.4, low: 5000, high: 80000}}
  sun: {elevation_deg: {uniform: [15, 60]}, azimuth_deg: {uniform: [0, 360]}}
  clouds: {type: {choice: {values: [noise, none], weights: [3, 1]}}, cover: {uniform: [0.1, 0.6]}}
"""
TURBIDITY, VISIBILITY = ("sky", "turbidity"), ("sky", "visibility_m")
ELEVATION, AZIMUTH = ("sky", "sun", "elevation_deg"), ("sky", "sun", "azimuth_deg")
SEASON, TYPE = ("plants", "season"), ("sky", "clouds", "type")
STEPS, ALTITUDE = ("community", "steps"), ("site", "altitude_m")


@pytest.fixture
def load(write: Write) -> Callable[..., LoadedRecipe]:
    def _load(sampling: str = "", *swap: tuple[str, str]) -> LoadedRecipe:
        text = TEXT + (f"sampling: {sampling}\n" if sampling else "")
        for old, new in swap:
            assert old in text
            text = text.replace(old, new)
        return load_recipe(write(text))

    return _load


Load = Callable[..., LoadedRecipe]


def columns(loaded: LoadedRecipe, images: int) -> dict[Any, list[Any]]:
    rows = [loaded.draws.values(image) for image in range(images)]
    return {keys: [row[keys] for row in rows] for keys in rows[0]}


def unit(loaded: LoadedRecipe, images: int, *keys: Any) -> np.ndarray[Any, Any]:
    """(images, keys) places in the ranges of uniform distributions."""
    drawn = columns(loaded, images)
    ranges = [loaded.written[key]["uniform"] for key in keys]
    return np.array(
        [(np.array(drawn[key]) - low) / (high - low) for key, (low, high) in zip(keys, ranges, strict=True)]
    ).T


@pytest.mark.parametrize("method", METHODS)
def test_every_method_keeps_each_distribution(load: Load, method: str) -> None:
    drawn = columns(load(f"{{method: {method}}}"), 1500)
    normal, lognormal = stats.truncnorm(-1.5, np.inf, 300, 200), stats.lognorm(0.4, scale=20000)
    low, high = lognormal.cdf([5000, 80000])
    assert stats.kstest(drawn[TURBIDITY], stats.uniform(2, 4).cdf).pvalue > 1e-3
    assert stats.kstest(drawn[ALTITUDE], normal.cdf).pvalue > 1e-3
    assert stats.kstest(drawn[VISIBILITY], lambda x: (lognormal.cdf(x) - low) / (high - low)).pvalue > 1e-3
    assert stats.chisquare(list(Counter(drawn[STEPS]).values())).pvalue > 1e-3
    assert set(drawn[STEPS]) == set(range(10, 20))
    assert stats.chisquare([drawn[SEASON].count(one) for one in ("spring", "summer", "autumn", "dry")]).pvalue > 1e-3
    assert stats.chisquare([drawn[TYPE].count(one) for one in ("noise", "none")], [1125, 375]).pvalue > 1e-3


@pytest.mark.parametrize("method", EVEN)
def test_points_fill_the_space_more_evenly(load: Load, method: str) -> None:
    keys = (TURBIDITY, ELEVATION, AZIMUTH)
    even = qmc.discrepancy(unit(load(f"{{method: {method}}}"), 512, *keys))
    assert even < 0.5 * qmc.discrepancy(unit(load(), 512, *keys))


def test_each_block_of_a_latin_hypercube_has_one_value_in_each_bin(load: Load) -> None:
    loaded = load("{method: latin_hypercube, block: 32}")
    points = unit(loaded, 96, TURBIDITY, ELEVATION, AZIMUTH)
    for block in range(3):
        for column in points[32 * block : 32 * (block + 1)].T:
            assert sorted((column * 32).astype(int)) == list(range(32))
    assert not np.array_equal((points[:32] * 32).astype(int), (points[32:64] * 32).astype(int))


def test_the_property_holds_within_each_split(load: Load) -> None:
    loaded = load("{method: latin_hypercube, block: 16}", ("{train: 1}", "{train: 3, val: 1}"))
    by_split: dict[str, list[float]] = {}
    for image in range(64):
        drawn = loaded.draw(image)
        by_split.setdefault(drawn.split, []).append((drawn.recipe.sky.turbidity - 2) / 4)
    for values in by_split.values():
        whole = len(values) // 16 * 16
        assert whole
        for start in range(0, whole, 16):
            assert sorted(int(value * 16) for value in values[start : start + 16]) == list(range(16))


@pytest.mark.parametrize("method", EVEN)
def test_splits_have_points_of_their_own(load: Load, method: str) -> None:
    loaded = load(f"{{method: {method}}}", ("{train: 1}", "{train: 1, val: 1}"))
    values: dict[str, list[float]] = {"train": [], "val": []}
    for image in range(512):
        values["train" if image % 2 == 0 else "val"].append(loaded.draws.values(image)[TURBIDITY])  # type: ignore[arg-type]
    assert loaded.draw(0).split == "train"
    assert loaded.draw(1).split == "val"
    assert not set(values["train"]) & set(values["val"])
    for one in values.values():  # dealing images by a sequence of base 2 leaves no hole in either
        assert np.abs(np.sort(one) - np.linspace(2, 6, 256)).max() < 0.1


def test_strata_have_each_combination_once_a_block(load: Load) -> None:
    loaded = load("{strata: {plants.season: all, sky.sun.elevation_deg: 3, sky.clouds.type: 4, community.steps: all}}")
    cells = 4 * 3 * 4 * 10
    drawn = columns(loaded, 2 * cells)
    orders = []
    for block in range(2):
        part = slice(block * cells, (block + 1) * cells)
        bins = [int((value - 15) / 15) for value in drawn[ELEVATION][part]]
        found = Counter(zip(drawn[SEASON][part], bins, drawn[STEPS][part], drawn[TYPE][part], strict=True))
        assert len(found) == 4 * 3 * 10 * 2
        assert {count for (*_, kind), count in found.items() if kind == "noise"} == {3}  # weights 3 to 1, exactly
        assert {count for (*_, kind), count in found.items() if kind == "none"} == {1}
        orders.append(list(zip(drawn[SEASON][part], bins, drawn[STEPS][part], strict=True)))
    assert orders[0] != orders[1]
    assert stats.kstest(drawn[ELEVATION], stats.uniform(15, 45).cdf).pvalue > 1e-3


def test_strata_and_a_method_share_the_keys(load: Load) -> None:
    loaded = load("{method: sobol, strata: {plants.season: [spring, summer, autumn, dry]}}")
    drawn = columns(loaded, 256)
    for start in range(0, 256, 4):
        assert len(set(drawn[SEASON][start : start + 4])) == 4
    points = unit(loaded, 256, TURBIDITY)
    assert sorted((points[:, 0] * 256).astype(int)) == list(range(256))  # a Sobol net


@pytest.mark.parametrize("method", METHODS)
def test_correlations_are_those_asked_for(load: Load, method: str) -> None:
    pairs = (
        "[{keys: [sky.turbidity, sky.visibility_m], rank: -0.7}, {keys: [site.altitude_m, sky.turbidity], rank: 0.3}]"
    )
    drawn = columns(load(f"{{method: {method}, correlations: {pairs}}}"), 2000)
    error = 4 / np.sqrt(2000)
    assert stats.spearmanr(drawn[TURBIDITY], drawn[VISIBILITY])[0] == pytest.approx(-0.7, abs=error)
    assert stats.spearmanr(drawn[TURBIDITY], drawn[ALTITUDE])[0] == pytest.approx(0.3, abs=error)
    assert stats.spearmanr(drawn[ALTITUDE], drawn[VISIBILITY])[0] == pytest.approx(0.0, abs=error)
    assert stats.kstest(drawn[TURBIDITY], stats.uniform(2, 4).cdf).pvalue > 1e-3
    assert stats.kstest(drawn[ALTITUDE], stats.truncnorm(-1.5, np.inf, 300, 200).cdf).pvalue > 1e-3


def test_a_key_of_the_strata_stays_while_others_follow_it(load: Load) -> None:
    pair = "{keys: [sky.turbidity, sky.sun.elevation_deg], rank: 0.8}"
    drawn = columns(load(f"{{strata: {{sky.sun.elevation_deg: 9}}, correlations: [{pair}]}}"), 900)
    for start in range(0, 900, 9):
        assert len({int((value - 15) / 5) for value in drawn[ELEVATION][start : start + 9]}) == 9
    assert stats.spearmanr(drawn[TURBIDITY], drawn[ELEVATION])[0] == pytest.approx(0.8, abs=0.06)


FULL = (
    "{method: sobol, strata: {plants.season: all}, variables: {wetness: {uniform: [0, 1]}}, "
    "correlations: [{keys: [wetness, sky.sun.elevation_deg], rank: -0.5}]}"
)


@pytest.mark.parametrize("sampling", [FULL, FULL.replace("sobol", "latin_hypercube"), FULL.replace("sobol", "halton")])
def test_an_image_depends_on_no_order_and_no_count(load: Load, sampling: str) -> None:
    splits = ("{train: 1}", "{train: 8, val: 1}")
    loaded, other = load(sampling, splits), load(sampling, splits, ("seed: 5", "seed: 5\nimages: 3"))
    images = [*range(20), 5000, 65_540]
    expected = {image: loaded.draws.values(image) for image in images}
    for image in np.random.default_rng(1).permutation(images):
        assert other.draws.values(int(image)) == expected[int(image)]
    later = load(sampling, splits, ("seed: 5", "seed: 5\nfirst_image: 30"))
    assert later.draw(1).data == loaded.draw(31).data
    assert pickle.loads(pickle.dumps(loaded)).draw(1).data == loaded.draw(1).data
    assert load(sampling, splits, ("seed: 5", "seed: 6")).draws.values(0) != expected[0]


def test_a_sequence_begins_again_with_other_points(load: Load) -> None:
    loaded = load("{method: sobol}")
    assert loaded.draws.values(0)[TURBIDITY] != loaded.draws.values(2**16)[TURBIDITY]


def test_keys_leaves_the_others_as_they_were(load: Load) -> None:
    before, after = load(), load("{method: sobol, keys: [sky.turbidity]}")
    for image in range(5):
        one, two = before.draws.values(image), after.draws.values(image)
        assert {keys for keys in one if one[keys] != two[keys]} == {TURBIDITY}


@pytest.mark.parametrize("sampling", ["{}", "{method: independent, variables: {a: {uniform: [0, 1]}}}"])
def test_a_section_that_places_nothing_changes_nothing(load: Load, sampling: str) -> None:
    before, after = load(), load(sampling)
    for image in range(5):
        assert after.draws.values(image).items() >= before.draws.values(image).items()


def test_a_stored_recipe_gives_the_image_again(load: Load, tmp_path: Path) -> None:
    loaded = load(FULL)
    drawn = loaded.draw(7)
    assert "sampling" not in drawn.data
    assert drawn.draws == loaded.draws.values(7)
    assert ("sampling", "variables", "wetness") in drawn.draws
    path = tmp_path / "drawn.yaml"
    path.write_text(dump_yaml(drawn))
    again = load_recipe(path)
    assert again.draw(0).data == drawn.data
    assert again.draw(0).image_seed == drawn.image_seed
    assert again.hash == recipe_hash(drawn.data)


def test_the_section_is_part_of_the_recipes_hash(load: Load) -> None:
    assert len({load(one).hash for one in ("", "{method: sobol}", "{method: halton}", FULL)}) == 4


@pytest.mark.parametrize(
    ("sampling", "where"),
    [
        ("{method: sobl}", "sampling.method"),
        ("{methd: sobol}", "sampling.methd"),
        ("{method: sobol, keys: [sky.turbidty]}", "sampling.keys.0"),
        ("{method: sobol, keys: [site.altitude_m, site.altitude_m]}", "sampling.keys.1"),
        ("{method: sobol, keys: [community.model]}", "sampling.keys.0"),
        ("{keys: [sky.turbidity]}", "sampling.keys"),
        ("{method: halton, block: 4}", "sampling.method"),
        ("{strata: {sky.cover: 3}}", "sampling.strata.sky.cover"),
        ("{strata: {sky.turbidity: all}}", "sampling.strata.sky.turbidity"),
        ("{strata: {sky.turbidity: 0}}", "sampling.strata.sky.turbidity"),
        ("{strata: {plants.season: [spring]}}", "sampling.strata.plants.season"),
        ("{strata: {sky.clouds.type: all}}", "sampling.strata.sky.clouds.type"),
        ("{strata: {sky.turbidity: 200, community.steps: 60}}", "sampling.strata"),
        ("{correlations: [{keys: [sky.turbidity, sky.sum], rank: 0.5}]}", "correlations.0.keys.1"),
        ("{correlations: [{keys: [sky.turbidity, sky.turbidity], rank: 0.5}]}", "correlations.0"),
        ("{correlations: [{keys: [sky.turbidity, site.altitude_m], rank: 1}]}", "correlations.0.rank"),
        ("{variables: {a: {formula: b}, b: {formula: a}}}", "sampling.variables.a"),
        ("{variables: {a: [1]}}", "sampling.variables.a"),
        ("{variables: {sin: 1}}", "sampling.variables.sin"),
        ("{variables: {a: {formula: '1/0'}}}", "sampling.variables.a"),
        ("{variables: {a: t, b: {formula: 2*a}}}", "sampling.variables.b"),
        ("{variables: {a: {choice: [[1]]}}}", "sampling.variables.a"),
        ("3", "sampling")
    ],
)  # fmt: skip
def test_mistakes(load: Load, sampling: str, where: str) -> None:
    with raises_error(RecipeError) as caught:
        load(sampling)
    message = str(caught.value)
    assert where in message.splitlines()[0]


def test_a_sequence_is_not_placed(load: Load) -> None:
    with raises_error(RecipeError, place="sampling.strata.sky.turbidity"):
        load("{strata: {sky.turbidity: 2}}", ("{uniform: [2, 6]}", "{sequence: [2, 6]}"))


def test_correlations_that_cannot_be_name_a_pair_and_the_nearest_value(load: Load) -> None:
    text = (
        "{{correlations: [{{keys: [sky.turbidity, sky.visibility_m], rank: 0.9}}, "
        "{{keys: [sky.visibility_m, site.altitude_m], rank: 0.9}}, "
        "{{keys: [sky.turbidity, site.altitude_m], rank: {}}}]}}"
    )
    with raises_error(RecipeError, place="sampling.correlations.2") as caught:
        load(text.format(0.1))
    message = str(caught.value)
    nearest = float(message.partition("rank: ")[2].split()[0])
    assert 0.5 < nearest < 0.9
    load(text.format(nearest))  # it is feasible,
    with pytest.raises(RecipeError):
        load(text.format(nearest - 0.002))  # and no nearer one is
