"""The stand table against figures computed by hand from plants.parquet of the same stand, rendered."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import forestgen as fg
from forestgen.instruments.stand_table import StandTable, _Plants, _row

# Two species of trees of all heights above, and below, 7 cm at 1.3 m; herbs; a site that repeats.
RECIPE: dict[str, Any] = {
    "forestgen": 1,
    "seed": 3,
    "site": {"size_m": [12, 10]},
    "species": {"spruce": None, "birch": None, "fireweed": None},
    "community": {
        "model": "poisson_disc",
        "plants": {
            "spruce": {"count": 14, "radius_m": {"median": 1.0, "sigma": 0.6}},
            "birch": {"count": 8, "radius_m": {"median": 0.8, "sigma": 0.5}},
            "fireweed": {"count": 12},
        },
    },
    "plants": {"exemplars_per_species": 2},
    "sky": {"clouds": "none"},
    "cameras": [{"name": "a", "position_m": [6, -8, 2], "look_at_m": [6, 5, 4], "size_px": [24, 16]}],
    "render": {"samples": 1, "denoise": False},
    "labels": {"samples": 1},
}
HA = 12 * 10 / 1e4


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set") / "out"
    fg.load(RECIPE).render(folder, progress=False)
    return folder


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[StandTable, Path]:
    folder = tmp_path_factory.mktemp("stand") / "out"
    return fg.load(RECIPE).stand(folder, progress=False), folder


def columns(folder: Path) -> dict[str, np.ndarray[Any, Any]]:
    table = pq.read_table(next(folder.rglob("plants.parquet")))
    return {name: np.array(table[name].to_pylist(), dtype=None) for name in ("species", "height_m")} | {
        name: np.array(table[name].to_pylist(), dtype=float) for name in ("dbh_m", "leaf_area_m2")
    }


def test_figures_are_those_of_the_plants_table(rendered: Path, measured: tuple[StandTable, Path]) -> None:
    plants, (table, _) = columns(rendered), measured
    dbh = np.nan_to_num(plants["dbh_m"])
    height = plants["height_m"].astype(float)
    dominant = height[np.argsort(-dbh)[: round(100 * HA)]].mean()  # one tree: the site is 0.012 ha
    storey = np.where(height >= dominant * 2 / 3, "upper", np.where(height >= dominant / 3, "middle", "lower"))
    seen = set()
    for row in table.rows:
        mine = ((plants["species"] == row.species) | (row.species == "all")) & (
            (storey == row.storey) | (row.storey == "all")
        )
        big = mine & (dbh >= 0.07)
        seen.add((row.species, row.storey))
        assert row.stems_per_ha == pytest.approx(big.sum() / HA)
        assert row.basal_area_m2_per_ha == pytest.approx(np.pi / 4 * (dbh[big] ** 2).sum() / HA)
        assert row.leaf_area_index == pytest.approx(np.nansum(plants["leaf_area_m2"][mine]) / HA / 1e4)
        if big.any():
            mean = 100 * math.sqrt((dbh[big] ** 2).mean())
            assert row.quadratic_mean_diameter_cm == pytest.approx(mean)
            assert row.mean_height_m == pytest.approx(height[big].mean())
            assert row.slenderness == pytest.approx(np.median(height[big] / dbh[big]))
            # Stems are between a paraboloid and a cone; some branches and the roots' flare count besides.
            form = row.stem_volume_m3_per_ha / (np.pi / 4 * (dbh[big] ** 2 * height[big]).sum() / HA)
            assert 0.3 < form < 0.7
        else:
            assert math.isnan(row.mean_height_m)
    assert {(name, "all") for name in ("spruce", "birch", "fireweed", "all")} < seen
    assert table.total.dominant_height_m == pytest.approx(dominant)
    assert 0 < (dbh[dbh > 0] < 0.07).sum() < (dbh > 0).sum()  # both kinds of trees are there


def test_cover_and_profile_agree_with_the_sums(measured: tuple[StandTable, Path]) -> None:
    table, _ = measured
    by = {(row.species, row.storey): row for row in table.rows}
    trees = [row.canopy_cover for row in table.rows if row.storey == "all" and row.species != "all"]
    assert max(trees) <= table.total.canopy_cover <= min(1.0, sum(trees))
    assert by["fireweed", "all"].canopy_cover < 0.05  # below 1.3 m, but for the tallest
    for species, density in table.leaf_area_density.items():
        area = float(np.sum(density * np.diff(table.layer_edges_m)))
        assert area == pytest.approx(by[species, "all"].leaf_area_index, rel=1e-6)
    # The leaves' shade at most: of leaves without clumping, seen from above at any attitude.
    assert table.total.canopy_cover < 1 - math.exp(-table.total.leaf_area_index) + 0.1


def test_figures_are_the_same_where_copies_stand_around_the_site(measured: tuple[StandTable, Path]) -> None:
    around = fg.load({**RECIPE, "site": {**RECIPE["site"], "surroundings": "repeat"}}).stand(progress=False)
    for one, other in zip(measured[0].rows, around.rows, strict=True):
        figures, same = one.figures(), other.figures()
        assert same.pop("canopy_cover") == pytest.approx(figures.pop("canopy_cover"), abs=2e-4)  # a few rays graze
        assert same == figures


def test_index_and_manifest_have_the_same_figures(rendered: Path, measured: tuple[StandTable, Path]) -> None:
    table, _ = measured
    (row,) = pq.read_table(rendered / "index.parquet").to_pylist()
    figures = table.total.figures()
    assert {key: row[key] for key in figures} == figures
    manifest = json.loads(next(rendered.rglob("train/manifest.json")).read_text())
    (image,) = manifest["run"]["images"]
    assert image["stand"] == json.loads(json.dumps(table.as_dict()))


def test_files_hold_the_table(measured: tuple[StandTable, Path]) -> None:
    table, folder = measured
    rows = list(csv.DictReader((folder / "stand.csv").read_text().splitlines()))
    assert len(rows) == len(table.rows)
    assert float(rows[-1]["leaf_area_index"]) == table.total.leaf_area_index
    assert json.loads((folder / "stand.json").read_text())["rows"][-1]["species"] == "all"
    for name in ("height_diameter.png", "leaf_area_profile.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    text = str(table)
    assert "BA m2/ha" in text
    assert text.count("\nfireweed") == 1  # one storey: no sum of it


def beech_of(position_m: list[float], **community: Any) -> StandTable:
    """A stand of one beech of 12 m."""
    plants = [{"species": "beech", "position_m": position_m, "height_m": 12}]
    data = {
        **RECIPE,
        "site": {"size_m": [16, 16]},
        "species": {"beech": None},
        "community": {"model": "placed", "plants": plants, **community},
    }
    return fg.load(data).stand(progress=False)


@pytest.mark.slow
def test_crowns_wrap_where_the_site_repeats() -> None:
    """In a corner a tree covers as much as in the middle; where the site does not repeat, the crown's part on it."""
    middle, corner, bounded = beech_of([8, 8]), beech_of([0, 0]), beech_of([0, 0], periodic=False)
    cover = middle.total.canopy_cover
    assert 0.02 < cover < 0.3
    assert corner.total.canopy_cover == pytest.approx(cover, rel=0.08)
    assert 0.1 * cover < bounded.total.canopy_cover < 0.45 * cover
    for table in (corner, bounded):
        assert table.total.leaf_area_index == pytest.approx(middle.total.leaf_area_index, rel=1e-6)
        assert table.total.stems_per_ha == pytest.approx(1e4 / 256)
        assert {row.species for row in table.rows} == {"beech", "all"}
    assert len(str(middle).splitlines()) == 1 + 1 + 5  # one row of figures: there is nothing to sum


@pytest.mark.slow
def test_bare_ground_has_a_table() -> None:
    table = fg.load({**RECIPE, "community": {"model": "placed", "plants": []}}).stand(progress=False)
    (row,) = table.rows
    assert (row.stems_per_ha, row.leaf_area_index, row.canopy_cover) == (0.0, 0.0, 0.0)
    assert math.isnan(row.dominant_height_m)
    assert json.loads(json.dumps(table.as_dict(), allow_nan=False))["rows"][0]["mean_height_m"] is None


def test_the_dominant_height_of_a_row_is_that_of_its_stems() -> None:
    """Of one thick tree among nine thin ones, where a hectare's 100 thickest are ten: it is no lower than the mean."""
    n, dbh_m = 10, np.array([0.1, *[0.05] * 9])
    height_m, zero, every = np.array([9.0, *[4.0] * 9]), np.zeros(10), np.ones(10, dtype=np.bool_)
    plants = _Plants(
        ("beech",),
        0.1,
        0.07,
        every,
        ~every,
        zero.astype(np.intp),
        zero.astype(np.intp),
        dbh_m,
        height_m,
        zero,
        zero,
        zero,
    )
    row = _row(plants, "beech", "lower", every, np.zeros((1, 1), dtype=np.bool_))
    assert (row.stems_per_ha, row.mean_height_m, row.dominant_height_m) == (10, 9, 9)
    thin = _row(plants, "beech", "lower", np.arange(n) > 0, np.zeros((1, 1), dtype=np.bool_))
    assert (thin.stems_per_ha, thin.dominant_height_m) == (0, 4)
