"""What is no argument is refused at once, with the parameter's name as its place."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from api_recipe import STAND

import forestgen as fg
from forestgen.api.plants import grow_files
from forestgen.community.models.uniform import MODEL as UNIFORM
from forestgen.dataset.files import check_writable
from forestgen.render.studio import PictureSettings
from forestgen.runs.contract import RunOptions
from forestgen.runs.verify import verify
from support.error_messages import raises_error

Call = Callable[[Any], Any]


@pytest.fixture(scope="module")
def recipe() -> Any:
    return fg.load(STAND)


@pytest.mark.parametrize(
    ("place", "call"),
    [
        ("out", lambda r: r.render("a\0")),
        ("out", lambda r: r.render("/tmp/\ud800")),
        ("out", lambda r: r.batch(None)),
        ("resources", lambda r: r.batch("x", engine="dask", scheduler="tcp://x", resources="abc")),
        ("progress", lambda r: r.batch("x", progress=1)),
        ("progress", lambda r: r.simulate(progress="no")),
        ("timeout", lambda r: r.batch("x", timeout=10**5000)),
        ("worker_memory", lambda r: r.batch("x", worker_memory=10**5000)),
        ("samples", lambda r: r.light([(1, 2, 3)], samples=600.5)),
        ("out", lambda r: r.light([(1, 2, 3)], out="\0.csv")),
        ("at", lambda r: r.light(5)),
        ("instrument", lambda r: r.measure("light_metre")),
        ("keys", lambda r: r.measure("light_meter", ["at"])),
        ("at", lambda r: r.measure("light_meter", ["at=3"])),
        ("at", lambda r: r.measure("light_meter")),
        ("spectrums", lambda r: r.measure("light_meter", {"at": [(1, 2, 3)], "spectrums": 5})),
        ("out", lambda r: r.measure("gap_fraction", out="gaps.csv")),
        ("min_dbh_cm", lambda r: r.stand(min_dbh_cm=-1)),
        ("out", lambda r: r.stand("\0")),
        ("map_steps", lambda r: r.simulate(map_steps=[1.5])),
        ("count", lambda r: r.weather(1.5)),
        ("width_px", lambda r: r.calibrate(width_px=64.5)),
        ("ax", lambda r: r.simulate(progress=False).plot(ax=3)),
        ("steps", lambda _: fg.derive("koch", 1.5)),
        ("max_modules", lambda _: fg.derive("koch", 2, max_modules=10**12)),
        ("max_modules", lambda _: fg.derive("koch", 2, max_modules=float("nan"))),  # type: ignore[arg-type]
        ("file", lambda _: fg.derive("a" * 300)),
        ("name", lambda _: fg.models(5)),  # type: ignore[arg-type]
        ("height_m", lambda _: fg.plant("fireweed", height_m="1 m")),  # type: ignore[arg-type]
        ("seed", lambda _: fg.plant("fireweed", seed=None)),  # type: ignore[arg-type]
        ("species", lambda _: fg.plant("firewed")),
        ("species", lambda _: fg.plant(None)),  # type: ignore[arg-type]
        ("source", lambda _: fg.load(None)),  # type: ignore[arg-type]
        ("set", lambda _: fg.load(STAND, set=5)),  # type: ignore[arg-type]
        ("set: seed", lambda _: fg.load(STAND, set={"seed": 10**5000})),
        ("allow_folders", lambda _: fg.load(STAND, allow_folders="/no/such")),
        ("points", lambda _: fg.stats("\0")),
        ("out", lambda _: fg.fit_kernel("x.csv", out="\0")),
        ("window", lambda _: fg.stats("x.csv", window=(-1e308, 1e308, -1e308, 1e308))),
        ("window", lambda _: fg.stats("x.csv", window=5)),  # type: ignore[arg-type]
        ("folder", lambda _: fg.Dataset("a" * 300)),
        ("folder", lambda _: fg.verify("a" * 300)),
        ("sources", lambda _: fg.merge(5, "x")),  # type: ignore[arg-type]
        ("samples", lambda _: PictureSettings(samples=0).check()),
        ("samples", lambda _: PictureSettings(samples=float("nan")).check()),  # type: ignore[arg-type]
        ("samples", lambda _: PictureSettings(samples=10**9).check()),
        ("size_px", lambda _: PictureSettings((32,)).check()),  # type: ignore[arg-type]
        ("size_px", lambda _: PictureSettings((32.5, 32)).check()),  # type: ignore[arg-type]
        ("out", lambda r: r.batch("")),
        ("out", lambda r: r.render("")),
        ("out", lambda r: r.simulate("")),
        ("out", lambda _: grow_files("fireweed", "")),
        ("source", lambda _: fg.load("")),
        ("resume", lambda r: r.render("x", resume="no")),
        ("discard", lambda r: r.batch("x", discard=1)),
        ("overwrite", lambda r: r.batch("x", overwrite=None)),
        ("overwrite", lambda _: check_writable([Path(__file__)], overwrite="no")),  # type: ignore[arg-type]
        ("hashes", lambda _: verify(Path("x"), hashes="no")),  # type: ignore[arg-type]
        ("retries", lambda r: r.batch("x", retries=None)),
        ("workers", lambda r: r.batch("x", workers=2.0)),
        ("count", lambda r: r.frames(-1)),
        ("first", lambda r: r.frames(1, first=2**64)),
        ("normal", lambda r: r.calibrate(normal="uff")),
        ("normals", lambda r: r.light([(1, 2, 3)], normals=["uff"])),
        ("at", lambda r: r.light(np.array(3))),
        ("height_m", lambda _: fg.plant("fireweed", 10**400)),
        ("kind", lambda _: fg.models(kind="specie")),
        ("name", lambda _: fg.models("sprce")),
        ("name", lambda _: fg.register("community_model", "1st", UNIFORM)),
        ("name", lambda _: fg.register("community_model", "uniform", UNIFORM)),
        ("part", lambda _: fg.register("community_model", "mine", copy(UNIFORM))),
    ],
)
def test_a_wrong_argument_is_named(place: str, call: Call, recipe: Any) -> None:
    with pytest.raises(fg.ForestgenError) as caught:
        call(recipe)
    assert caught.value.where == place
    assert caught.value.parameter == (None if ": " in place else place)
    assert caught.value.__cause__ is None or not type(caught.value.__cause__).__module__.startswith("pydantic")


def test_whole_numbers_may_be_those_of_numpy(recipe: Any) -> None:
    options = RunOptions(count=np.int64(3), threads=np.int32(1), workers=np.uint8(2), retries=np.int64(0)).check()  # type: ignore[arg-type]
    assert {type(one) for one in (options.count, options.threads, options.workers, options.retries)} == {int}
    shot = PictureSettings((np.int64(32), np.int64(24)), samples=np.int64(4)).check()  # type: ignore[arg-type]
    assert {type(one) for one in (*shot.size_px, shot.samples)} == {int}
    assert list(recipe.frames(np.int64(0))) == []


def test_one_text_is_no_list_of_letters(recipe: Any) -> None:
    with raises_error(fg.RecipeError, place="normals"):
        recipe.light([(1, 2, 3)], normals="uff")
    assert len(fg.load(STAND, set=None).data) == len(recipe.data)


def test_a_map_is_drawn_into_given_axes(recipe: Any) -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    left, _ = figure.subplots(1, 2)
    assert recipe.simulate(progress=False).plot(left) is figure
    assert left.patches or left.collections


def test_a_bad_value_shows_no_traceback_of_the_schema_library() -> None:
    with pytest.raises(fg.RecipeError) as caught:
        fg.load(STAND, set={"seed": -1})
    assert caught.value.__cause__ is None
    assert caught.value.__suppress_context__


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("site.size_m", ["30 m", "30 m"]),
        ("sky.sun.elevation_deg", "0.7 rad"),
        ("cameras.0.size_px", "160x96"),
        ("cameras.0.size_px", 160),
        ("site.terrain", "rollin"),
        ("sky.clouds", "cumulous"),
    ],
)
def test_hints_at_units_and_choices(key: str, value: Any) -> None:
    with raises_error(fg.RecipeError):
        fg.load(STAND, set={key: value})


def test_dir_lists_what_is_offered() -> None:
    assert sorted(dir(fg)) == sorted(fg.__all__)
