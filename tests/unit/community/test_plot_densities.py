"""The picture of densities shows them the right way up, what is barred, and the plants."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from forestgen.community.placement.model import Densities
from forestgen.community.plots import _fewer, plot_densities
from forestgen.community.population import Population, Site

NAMES = ("tree", "b")
SQUARE = Site((20.0, 20.0))


def stand(places, species=None):
    n = len(places)
    return Population(
        time_yr=0.0,
        species_names=NAMES,
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=np.zeros(n, np.uint16) if species is None else np.asarray(species, np.uint16),
        position_m=np.column_stack([np.reshape(places, (n, 2)), np.zeros(n)]),
        radius_m=np.ones(n),
        height_m=np.ones(n),
        age_yr=np.ones(n),
        status=np.zeros(n, np.uint8),
    )


def quarters(path):
    """Mean brightness of the map's quarters: north-west, north-east, south-west, south-east."""
    with Image.open(path) as image:
        grey = np.asarray(image.convert("L"), dtype=float)
    # The frame around the map is the longest dark line of rows and of columns.
    rows, cols = (np.flatnonzero((grey < 60).mean(axis=axis) > 0.5) for axis in (1, 0))
    inner = grey[rows[0] + 4 : rows[-1] - 3, cols[0] + 4 : cols[cols < grey.shape[1] * 0.85][-1] - 3]
    half = inner.shape[0] // 2, inner.shape[1] // 2
    return [inner[: half[0], : half[1]], inner[: half[0], half[1] :], inner[half[0] :, : half[1]],
            inner[half[0] :, half[1] :]]  # fmt: skip


def south_west():
    density = np.zeros((40, 40))
    density[:20, :20] = 100.0
    return density


def drawn(tmp_path, densities, placed, site=SQUARE, name="a.png"):
    plot_densities(densities, placed, site, {"tree": "#14532D"}, tmp_path / name)
    return tmp_path / name


def test_north_is_up_and_east_to_the_right(tmp_path):
    found = quarters(drawn(tmp_path, Densities({"tree": 1}, {"tree": south_west()}), stand([])))
    means = [quarter.mean() for quarter in found]
    assert means[2] < means[0] - 30
    assert means[0] == pytest.approx(means[1], abs=3)
    assert means[0] == pytest.approx(means[3], abs=3)


def test_a_wide_range_of_densities_is_shown_in_full(tmp_path):
    """Of 1000, 1 and 0: on a plain scale the last two would look alike."""
    density = south_west() * 10
    density[20:, :20] = 1.0
    north_west, north_east, south_west_, _ = (
        quarter.mean() for quarter in quarters(drawn(tmp_path, Densities({"tree": 1}, {"tree": density}), stand([])))
    )
    assert south_west_ < north_west - 30
    assert north_west < north_east - 3


def test_dots_are_whole_at_the_edge(tmp_path):
    densities = Densities({"tree": 1}, {"tree": np.ones((40, 40))})
    inside, corner = (
        drawn(tmp_path, densities, stand([place]), name=f"{place[0]}.png") for place in ([10.0, 10.0], [0.0, 10.0])
    )
    dark = [(np.asarray(Image.open(path).convert("L")) < 60).sum() for path in (inside, corner)]
    assert dark[1] > dark[0] - 40  # but for what the frame covers


def test_plants_are_dots_at_their_places(tmp_path):
    densities = Densities({"tree": 40}, {"tree": np.ones((40, 40))})
    places = 12 + 6 * np.random.default_rng(0).random((40, 2))
    north_west, north_east, south_west, south_east = (
        (quarter < 90).mean() for quarter in quarters(drawn(tmp_path, densities, stand(places)))
    )
    assert north_east > 0.01
    assert north_west == south_west == south_east == 0


def test_barred_ground_is_hatched(tmp_path):
    barred = np.zeros((40, 40), dtype=bool)
    barred[20:, :20] = True
    found = quarters(drawn(tmp_path, Densities({"tree": 1}, {"tree": np.where(barred, 0.0, 1.0)}, barred), stand([])))
    spread = [quarter.std() for quarter in found]
    assert spread[0] > 20
    assert max(spread[1:]) < 10


def test_a_row_for_each_species_and_a_column_for_the_field(tmp_path):
    fields = {name: np.ones((30, 30)) for name in NAMES}
    sizes = []
    for densities in (
        Densities({"tree": 4}, {"tree": fields["tree"]}),
        Densities({"tree": 4, "b": 4}, fields),
        Densities({"tree": 4, "b": 4}, fields, None, fields),
    ):
        with Image.open(drawn(tmp_path, densities, stand([[1, 1]]))) as image:
            sizes.append(image.size)
    assert sizes[1][0] == sizes[0][0]
    assert sizes[1][1] > 1.7 * sizes[0][1]
    assert sizes[2][0] > 1.7 * sizes[1][0]
    assert sizes[2][1] == sizes[1][1]


def test_the_same_picture_has_the_same_bytes(tmp_path):
    densities = Densities({"tree": 4}, {"tree": south_west()}, south_west() > 0)
    paths = [drawn(tmp_path, densities, stand([[1, 1]]), name=name) for name in ("a.png", "b.png")]
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize("size", [(1000.0, 10.0), (10.0, 1000.0), (0.5, 0.5)])
def test_odd_sites_and_densities(size, tmp_path):
    fields = {"tree": np.full((40, 2), 3e8), "b": np.zeros((40, 2))}
    densities = Densities({"tree": 0, "b": 3}, fields, np.ones((40, 2), dtype=bool), fields)
    assert drawn(tmp_path, densities, stand([]), Site(size)).stat().st_size > 0


def test_a_million_plants_are_not_all_drawn(tmp_path):
    places = np.random.default_rng(0).random((300_000, 2)) * 20
    path = drawn(tmp_path, Densities({"tree": 300_000}, {"tree": south_west()}), stand(places))
    assert path.stat().st_size < 2_000_000


@pytest.mark.parametrize("shape", [(640, 640), (641, 1), (1283, 2000), (3, 5000)])
def test_fewer_cells_hold_the_same_mean(shape):
    cells = np.random.default_rng(1).random(shape)
    few = _fewer(cells)
    assert max(few.shape) <= 640
    if all(side % few_side == 0 for side, few_side in zip(shape, few.shape, strict=True)):
        assert few.mean() == pytest.approx(cells.mean())
    assert abs(few.mean() - cells.mean()) < 0.01
