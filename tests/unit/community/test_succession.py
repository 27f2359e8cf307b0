"""The species that come with forestgen succeed each other as in Lane 2002, Fig. 4.5 and Table 7.1."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from forestgen.community.model import simulate
from forestgen.community.models.multiset_lsystem import MODEL
from forestgen.community.point_patterns import hopkins_index
from forestgen.community.population import Site, SpeciesEcology, count_by_species, cover_by_species

SITE = Site((120.0, 120.0))
SPECIES_FOLDER = Path(__file__).parents[3] / "scenes" / "species"
NAMES = ("fireweed", "poplar", "spruce")
STEPS = (20, 150, 300, 1000)


def load(name):
    data = YAML(typ="safe").load((SPECIES_FOLDER / f"{name}.yaml").read_text(encoding="utf-8"))
    height = data["allometry"]["height_m"]
    return SpeciesEcology(
        name=name,
        **{"seedling_radius_m": 0.05, **data["ecology"]},
        height_scale=height["scale"],
        height_exponent=height["exponent"],
    )


def measure(seeds, steps):
    """step -> mean over seeds of the total number, each species' cover, and H."""
    rows = {step: [] for step in steps}
    species = [load(name) for name in NAMES]
    for seed in seeds:
        for step, population in enumerate(simulate(MODEL, MODEL.Parameters(), SITE, species, seed, steps=max(steps))):
            if step in rows:
                total = sum(count_by_species(population).values())
                h = hopkins_index(population.position_m[:, :2], SITE.size_m, np.random.default_rng(0))
                rows[step].append([total, *cover_by_species(population, SITE.area_m2).values(), h])
    return {step: np.mean(values, axis=0) for step, values in rows.items()}


def check_order_of_dominance(measured):
    _, fireweed, poplar, spruce, _ = measured[20]
    assert fireweed > 3 * (poplar + spruce)
    _, fireweed, poplar, spruce, _ = measured[150]
    assert poplar > 1.3 * max(fireweed, spruce)
    _, fireweed, poplar, spruce, _ = measured[300]
    assert 0.7 * poplar < spruce < 1.7 * poplar
    assert fireweed < 0.5 * min(poplar, spruce)


@pytest.mark.slow
def test_succession_of_two_seeds():
    measured = measure((1, 2), STEPS[:3])
    check_order_of_dominance(measured)
    for step, number in zip(STEPS, (2688, 1593, 1409), strict=False):
        assert measured[step][0] == pytest.approx(number, rel=0.27)


@pytest.mark.slow
def test_succession_of_ten_seeds():
    measured = measure(range(10), STEPS)
    check_order_of_dominance(measured)
    _, fireweed, poplar, spruce, _ = measured[1000]
    assert spruce > 3 * max(fireweed, poplar)
    for step, number in zip(STEPS, (2688, 1593, 1409), strict=False):
        assert measured[step][0] == pytest.approx(number, rel=0.25)
    # The thesis has 834 plants at step 1000. Gaps between circles of these radii hold more herbs than that
    # (the model's page says why). Pinned here so that a change is noticed.
    assert measured[1000][0] == pytest.approx(1480, rel=0.1)
    # Overdispersed at every stage; the thesis finds 0.6 to 0.7.
    assert all(0.6 < measured[step][4] < 0.92 for step in STEPS)


def test_a_stand_of_300_steps_has_many_sizes():
    species = [load(name) for name in NAMES]
    *_, last = simulate(MODEL, MODEL.Parameters(), SITE, species, 1, steps=300)
    for index, name in ((1, "poplar"), (2, "spruce")):
        tall = last.height_m[(last.species == index) & (last.height_m > 2)]
        low, high = np.quantile(tall, [0.1, 0.9])
        assert high > 2.5 * low, name
        assert 16 < last.height_m[last.species == index].max() < 28
    assert 1.0 < last.height_m[last.species == 0].max() < 2.5
