"""What plants of an ecoclimate feel, how much leaf they hold over the ground, and seeds from elsewhere."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from ecoclimate_cases import HILLY, SITE, STEADY, after, around, ecology, parameters, plant_type, states

from forestgen.architecture.geometry import plant_sizes
from forestgen.community.branch_modules.state import LocalClimate, State, ground_at, step_parameters, suited
from forestgen.community.branch_modules.step import step_forest
from forestgen.community.disturbance import Planting
from forestgen.community.ecoclimate.months import Ecoclimate, leaf_area_index, local_climate
from forestgen.community.ecoclimate.parameters import GlobalSeeding
from forestgen.community.models.ecoclimate import MODEL
from forestgen.community.population import Site
from forestgen.community.soil_water import Ground

TWO = [ecology("tree"), ecology("bush", root_vigour_max=20, opacity=0.5, determinacy=0.2)]


def leaf_area_m2(state: Ecoclimate) -> float:
    forest = state.forest
    return float(plant_sizes(step_parameters(forest).tables, forest.modules, forest.plants.species).leaf_area_m2.sum())


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("steps", [1, 3, 8])
def test_leaves_over_the_ground_are_the_plants_leaves(periodic: bool, steps: int) -> None:
    """On grids of any cells, from the first leaves on; crowns reach over the edges."""
    state = after(steps, species=TWO, periodic=periodic, step_yr=1.0, initial_plants=30)
    own = leaf_area_m2(state)
    assert own > 0
    assert own == pytest.approx(MODEL.population(state).columns["leaf_area_m2"].sum(), rel=1e-5)
    for shape in ((1, 1), (4, 5), (13, 7), (60, 75)):
        ground = Ground(SITE.size_m, shape, periodic)
        index = leaf_area_index(state.forest, ground)
        assert index.shape == shape
        assert index.min() >= 0
        assert index.sum() * np.prod(ground.cell_m) == pytest.approx(own, rel=1e-12)


def test_leaves_lie_where_the_plants_are() -> None:
    """One plant at a corner: all leaves near it, on a torus at all four corners, else at the one."""
    for periodic in (False, True):
        corner = Planting(np.zeros(1, np.uint16), np.array([[0.05, 0.05]]), np.ones(1))
        state = MODEL.plant(after(0, periodic=periodic, step_yr=1.0, initial_plants=0), corner)
        for _ in range(8):
            state = MODEL.step(state)
        index = leaf_area_index(state.forest, Ground(SITE.size_m, (4, 4), periodic))
        assert index[1:3, 1:3].sum() < 0.05 * index.sum()
        assert (index[-1, -1] > 0) == periodic


def test_a_stand_without_plants_has_no_leaves() -> None:
    state = after(0, initial_plants=0)
    assert not leaf_area_index(state.forest, Ground(SITE.size_m, (3, 4), False)).any()


def felt(state: Ecoclimate, position_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) temperature and precipitation that plants feel there."""
    climate = local_climate(state)
    return climate.at(position_m, climate.light_at(position_m, around(state)))


def places(count: int = 200) -> np.ndarray:
    return np.random.default_rng(4).random((count, 2)) * SITE.size_m


def test_without_microclimate_all_plants_feel_the_same_but_for_elevation() -> None:
    position = places()
    for site in (SITE, HILLY):
        state = after(6, site, step_yr=1.0, microclimate=False, initial_plants=25, soil_water={"cell_m": 0.5})
        warmth, rain = felt(state, position)
        assert np.ptp(rain) == 0
        at_0 = warmth + 6.5 * ground_at(site, position) / 1000
        assert np.ptp(at_0) < 6e-3  # of 0.03 K: a cell's middle is not quite its plants' foot
        # It is the mean of shade that cools them, between none and all.
        assert state.temperature_mean_c - 4.0 < at_0.mean() < state.temperature_mean_c - 0.05


def test_with_microclimate_shade_cools_and_wet_places_are_wetter() -> None:
    state = after(8, HILLY, step_yr=1.0, initial_plants=25, soil_water={"cell_m": 1.0})
    position, seen = places(), around(state)
    warmth, rain = felt(state, position)
    light = seen.light_at(position)
    assert np.ptp(light) > 0.1
    assert warmth == pytest.approx(
        state.temperature_mean_c - 0.0065 * ground_at(HILLY, position) - 4.0 * (1 - light), abs=0.01
    )
    row, col = (np.minimum((position[:, k] / SITE.size_m[k] * n).astype(int), n - 1) for k, n in ((1, 12), (0, 15)))
    wetness = state.soil_mean_mm[row, col]
    assert np.all(np.diff(rain[np.argsort(wetness)]) >= 0)
    assert np.ptp(rain) > 0.2 * rain.mean()


def test_shade_does_not_cool_where_the_recipe_says_so() -> None:
    state = after(6, step_yr=1.0, shade_cooling_k=0.0, initial_plants=25)
    warmth, _ = felt(state, places())
    assert warmth == pytest.approx(state.temperature_mean_c, rel=1e-12)


def test_means_of_even_and_local_shade_agree() -> None:
    """The ablation takes away where it is cool, not how cool it is."""
    state = after(8, step_yr=1.0, initial_plants=25)
    size, seen = SITE.size_m, around(state)
    maps = np.full((60, 75), 10.0), np.zeros((60, 75))
    x, y = ((np.arange(n) + 0.5) / n * side for n, side in ((75, size[0]), (60, size[1])))
    position = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    local, even = (LocalClimate(size, *maps, 4.0, even_shade=one) for one in (False, True))
    here, mean = (one.at(position, one.light_at(position, seen))[0] for one in (local, even))
    assert np.ptp(here) > 0.2
    assert np.ptp(mean) == 0
    assert here.mean() == pytest.approx(mean[0], abs=1e-9)


def test_adaptation_is_that_of_the_paper() -> None:
    """Eq. 38 is 1 at the optimum, and the product of two bells around it."""
    state = after(0)
    traits = step_parameters(state.forest).traits
    one = np.zeros(5, dtype=np.uint16)
    found = suited(traits, one, np.array([8.0, 16.0, 0.0, 8.0, 16.0]), np.array([700.0, 700.0, 700.0, 1200.0, 1200.0]))
    assert found == pytest.approx([1, np.exp(-0.5), np.exp(-0.5), np.exp(-0.5), np.exp(-1)])


def test_plants_live_where_it_is_wet_enough_and_die_where_it_is_not() -> None:
    """The same plants under the rain that they like, a third of it, and none."""
    alive = {}
    for rain in (60.0, 20.0, 0.0):
        climate = {**STEADY, "precipitation_mm": [rain] * 12}
        state = after(15, step_yr=1.0, climate=climate, species=[ecology(precipitation_width_mm_per_yr=150.0)])
        alive[rain] = leaf_area_m2(state)
    assert alive[60.0] > 5 * alive[20.0]
    assert alive[0.0] == 0


def evenly(temperature_c: float) -> LocalClimate:
    return LocalClimate(SITE.size_m, np.full((1, 1), temperature_c), np.full((1, 1), 700.0))


def vigour_of_roots(forest: State, temperature_c: float) -> np.ndarray:
    """(P,) by plant_id, after a step in which it was so warm; 0 for those that died of it."""
    later = step_forest(forest, evenly(temperature_c))
    rows = later.modules.first[:-1]
    found = dict(zip(later.plants.plant_id.tolist(), later.modules.vigour[rows].tolist(), strict=True))
    return np.array([found.get(one, 0.0) for one in forest.plants.plant_id.tolist()])


def test_leaves_gain_the_less_the_less_the_climate_suits_and_nothing_below_what_they_need() -> None:
    """Roots without a cap: the vigour is what leaves gain, which is (o Q - c) / (1 - c) of each."""
    free = [ecology(root_vigour_max=1e5, temperature_c=10.0, temperature_width_c=5.0, seeds_per_yr=0.0)]
    forest = after(8, species=free, step_yr=1.0, climate=STEADY).forest
    c = float(step_parameters(forest).traits.compensation[0])
    warmth = [10.0, 12.0, 14.0]
    vigours = [vigour_of_roots(forest, one) for one in warmth]
    grown = vigours[0] > 0.5
    assert grown.sum() >= 5
    assert all(np.all(a[grown] > b[grown]) for a, b in pairwise(vigours))
    deadly = 10.0 + 5.0 * np.sqrt(-2 * np.log(0.9 * c))  # o below c: leaves in full light cost more than they bring
    assert not vigour_of_roots(forest, deadly).any()


def test_seeds_of_what_likes_shade_arrive_where_shade_is() -> None:
    """In the open it is too warm for them."""
    cool = ecology("cool", temperature_c=4.0, temperature_width_c=1.5, seeds_per_yr=0.0, shade_tolerance=0.95)
    keys: dict[str, Any] = {
        "species": [ecology("tree", temperature_c=10.0, seeds_per_yr=0.0), cool],
        "step_yr": 1.0,
        "climate": STEADY,
        "shade_cooling_k": 10.0,
        "global_seeding": [{"species": ["cool"], "seeds_per_ha": 20_000}],
    }
    counts = [np.sum(after(15, initial_plants={"tree": n}, **keys).forest.plants.species == 1) for n in (0, 60)]
    assert counts[0] == 0
    assert counts[1] > 5


# Seeds from elsewhere

OPEN: dict[str, Any] = {
    "seedling_spacing_m": 0,
    "adaptation_min": 0,
    "initial_plants": 0,
    "climate": STEADY,
    "soil_water": {"cell_m": 15.0, "substep_days": 31.0},
}
AT_EASE = {"temperature_c": 10.0, "precipitation_mm_per_yr": 720.0, "seeds_per_yr": 0.0}


def arrivals(years: int, seeds: list[dict[str, Any]], seed: int = 1, **keys: Any) -> np.ndarray:
    """(steps, species) plants that arrive in each step, of species A, at ease, and B; they are taken away again."""
    species = [ecology("a", **AT_EASE), ecology("b", **{**AT_EASE, **keys.pop("b", {})})]
    chosen = parameters(**{**OPEN, "global_seeding": seeds, **keys})
    state = MODEL.init(chosen, SITE, species, seed)
    counts = []
    for _ in range(round(years / chosen.step_yr)):
        state = MODEL.step(state)
        new = state.forest.plants.born == state.forest.step
        counts.append(np.bincount(state.forest.plants.species[new], minlength=2))
        state = MODEL.remove(state, state.forest.plants.plant_id)  # the ground stays open
    return np.array(counts)


@pytest.mark.parametrize(("step_yr", "every_yr"), [(1 / 12, 0.25), (0.5, 0.25), (1.0, 0.25), (1.0, 1.0), (0.25, 1.0)])
def test_seeds_are_poisson_of_the_mean_whatever_the_step(step_yr: float, every_yr: float) -> None:
    """Mean and variance of a year's seedlings on 0.018 ha; at ease, all germinate."""
    each, years = 1000.0, 12
    found = arrivals(years, [{"seeds_per_ha": each, "every_yr": every_yr}], step_yr=step_yr)
    totals = found.reshape(years, -1, 2).sum(axis=1)  # a year's, of each species: independent
    expected, count = each * SITE.area_ha / every_yr, totals.size
    assert abs(totals.mean() - expected) < 4 * np.sqrt(expected / count)
    assert 0.33 < totals.var() / expected < 2.16  # of 23 degrees of freedom: so but for one in 500
    assert abs(np.corrcoef(totals.T)[0, 1]) < 0.85


def test_seeds_come_at_their_times_and_no_other() -> None:
    found = arrivals(3, [{"seeds_per_ha": 3000, "every_yr": 0.5, "from_yr": 1.0, "species": ["b"]}])
    assert not found[:, 0].any()
    assert np.flatnonzero(found[:, 1]).tolist() == [12, 18, 24, 30]


@pytest.mark.parametrize(("from_yr", "every_yr"), [(0.0, 1 / 12), (0.3, 0.7), (5.0, 3.0), (0.0, 0.01), (1e6, 1.0)])
@pytest.mark.parametrize("months", [1, 5, 12])
def test_no_time_is_missed_or_counted_twice(from_yr: float, every_yr: float, months: int) -> None:
    one = GlobalSeeding(from_yr=from_yr, every_yr=every_yr)
    ends = [one.times_before(month) for month in range(0, 12 * 600 + 1, months)]
    assert ends[0] == 0
    assert np.all(np.diff(ends) >= 0)
    end_yr = (len(ends) - 1) * months / 12
    assert ends[-1] == np.sum(from_yr + every_yr * np.arange(70_000) < end_yr - 1e-9)


def test_no_seed_germinates_where_the_climate_does_not_suit() -> None:
    found = arrivals(2, [{"seeds_per_ha": 3000}], b={"temperature_c": 33.0, "temperature_width_c": 0.5}).sum(axis=0)
    assert found[0] > 50
    assert found[1] == 0


def test_as_many_germinate_as_the_climate_suits() -> None:
    """A species one width off its optimum has exp(-1/2) of the seedlings."""
    off = {"temperature_c": 14.0, "temperature_width_c": 4.0}
    seeds = [{"seeds_per_ha": 10_000}]
    found = arrivals(20, seeds, b=off, shade_cooling_k=0.0, step_yr=1.0).sum(axis=0)
    expected = 10_000 * SITE.area_ha * 20
    assert abs(found[0] - expected) < 4 * np.sqrt(expected)
    assert abs(found[1] - expected * np.exp(-0.5)) < 4 * np.sqrt(expected * np.exp(-0.5))


def test_seeds_fall_evenly_over_the_site() -> None:
    chosen = parameters(**OPEN, global_seeding=[{"seeds_per_ha": 60_000}])
    state = MODEL.step(MODEL.init(chosen, SITE, [ecology(**AT_EASE)], 1))
    at = state.forest.plants.position_m
    assert np.all((at >= 0) & (at <= SITE.size_m))
    counts = np.histogram2d(at[:, 0], at[:, 1], bins=(5, 4), range=((0, 15), (0, 12)))[0].ravel()
    mean = counts.mean()
    assert mean > 40
    assert ((counts - mean) ** 2 / mean).sum() < 43.8  # chi square, 19 degrees of freedom, one in 1,000


def test_the_same_seed_gives_the_same_arrivals_and_another_others() -> None:
    seeds = [{"seeds_per_ha": 2000}]
    assert np.array_equal(arrivals(2, seeds, 7), arrivals(2, seeds, 7))
    assert not np.array_equal(arrivals(2, seeds, 7), arrivals(2, seeds, 8))


def test_seeds_from_elsewhere_leave_those_of_the_stand_alone() -> None:
    """The seeds that plants of the stand drop in a step are the same with arrivals of another species and without."""

    def stand(seeding: list[dict[str, Any]]) -> Ecoclimate:
        start = {"initial_plants": {"a": 8}, "climate": STEADY, "step_yr": 1.0}
        species = [ecology("a"), ecology("b", **AT_EASE)]
        return after(5, species=species, **start, global_seeding=seeding)

    with_seeds, without = stand([{"species": ["b"], "seeds_per_ha": 4000, "from_yr": 4}]), stand([])
    plants = with_seeds.forest.plants
    assert (plants.species == 1).sum() > 5
    own = plants.where(plants.species == 0)
    assert (own.born == 5).sum() > 0
    assert own.position_m.tobytes() == without.forest.plants.position_m.tobytes()
    assert own.plant_id.tobytes() == without.forest.plants.plant_id.tobytes()


def test_a_site_can_begin_empty_and_be_found_by_seeds() -> None:
    chosen = parameters(initial_plants=0, global_seeding=[{"seeds_per_ha": 500}])
    species = [ecology()]
    assert MODEL.empty_reason(chosen, SITE, species) is None
    assert "initial_plants is 0" in (MODEL.empty_reason(parameters(initial_plants=0), SITE, species) or "")
    assert MODEL.expected_plants(chosen, SITE, species) > 0
    counts = [
        len(state.forest.plants)
        for state, _ in zip(
            states(initial_plants=0, step_yr=1.0, global_seeding=[{"seeds_per_ha": 5e4}]), range(10), strict=False
        )
    ]
    assert max(counts) > 50
    assert max(counts) <= MODEL.expected_plants(chosen, SITE, species)


def test_species_that_are_not_named_are_all_that_grow() -> None:
    found = arrivals(2, [{"seeds_per_ha": 3000}]).sum(axis=0)
    assert np.all(found > 50)
    assert plant_type(**AT_EASE).temperature_c == 10.0


def test_small_and_large_sites_take_seeds_by_their_area() -> None:
    totals = []
    for size in ((6.0, 5.0), (24.0, 20.0)):
        species, chosen = (
            [ecology(**AT_EASE)],
            parameters(**OPEN, global_seeding=[{"seeds_per_ha": 20_000}], step_yr=1.0),
        )
        state = MODEL.step(MODEL.init(chosen, Site(size), species, 2))
        totals.append(len(state.forest.plants))
    assert abs(totals[0] - 60) < 4 * np.sqrt(60)
    assert abs(totals[1] - 960) < 4 * np.sqrt(960)
