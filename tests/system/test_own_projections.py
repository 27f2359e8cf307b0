"""The projection of examples/plugin is drawn, labelled, written, verified and refused like those that come along."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from batch_runs import RECIPE, recipe

import forestgen as fg
from forestgen.core import registry
from forestgen.recipe.cameras import Camera as CameraKeys
from forestgen.recipe.registries import PROJECTIONS
from forestgen.scene.projection import Floats, Pixels, Projection, Rays
from forestgen.scene.spec import Camera
from support.error_messages import raises_error

PLUGIN = str(Path(__file__).parents[2] / "examples" / "plugin")
WIDTH, HEIGHT, HFOV_DEG, HORIZON = 40, 20, 200.0, 0.4
POSITION_M = np.array([3.0, 2.0, 1.5])
CAMERA = (
    f"  - {{name: round, kind: cylindrical, size_px: [{WIDTH}, {HEIGHT}], hfov_deg: {HFOV_DEG}, horizon: {HORIZON}, "
    f"position_m: {POSITION_M.tolist()}}}\n"
)
OWN = RECIPE[: RECIPE.index("  - {name: left")] + CAMERA + RECIPE[RECIPE.index("render:") :]


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What a test registers is forgotten."""
    entries, registered = dict(PROJECTIONS._entries), list(registry._registered)
    monkeypatch.syspath_prepend(PLUGIN)
    fg.register("projection", "cylindrical", "forestgen_plantation.cylindrical:PROJECTION", "a turning slit camera")
    yield
    PROJECTIONS._entries.clear()
    PROJECTIONS._entries.update(entries)
    registry._registered[:] = registered
    for name in [name for name in sys.modules if name.startswith("forestgen_plantation")]:
        del sys.modules[name]


def test_labels_are_those_of_its_own_formulas(tmp_path: Path) -> None:
    """What a pixel's centre sees lies on the ray that the definition gives it; `verify` finds nothing."""
    run = fg.load(recipe(tmp_path, OWN)).batch(tmp_path / "set", 1, workers=1, threads=1, progress=False)
    root = Path(run.target)
    (folder,) = (root / "train").glob("*-round")
    camera = json.loads((folder / "camera.json").read_text())
    assert (camera["model"], camera["hfov_deg"], camera["numbers"]) == ("cylindrical", HFOV_DEG, {"horizon": HORIZON})
    (frame,) = fg.Dataset(root)
    position, radiance = frame.position.astype(float), frame.radiance
    solid = np.isfinite(position).all(axis=-1)
    assert 100 < solid.sum() < solid.size
    away = position[solid] - POSITION_M
    longitude, slope = np.arctan2(away[:, 0], away[:, 1]), -away[:, 2] / np.hypot(away[:, 0], away[:, 1])
    focal_px = WIDTH / np.radians(HFOV_DEG)
    row, column = np.nonzero(solid)
    np.testing.assert_allclose(focal_px * longitude + WIDTH / 2, column + 0.5, atol=2e-3)
    np.testing.assert_allclose(focal_px * slope + HORIZON * HEIGHT, row + 0.5, atol=2e-3)
    np.testing.assert_allclose(frame.depth[solid], np.linalg.norm(away, axis=1), rtol=1e-5)
    assert len(np.unique(frame.instance)) > 1
    assert (radiance[solid].mean(axis=-1) > 0).mean() > 0.9
    assert fg.verify(root, workers=1, progress=False).findings == ()


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        ("kind: cylindrical, horizon: 2", "horizon"),
        ("kind: cylindrical, hfov_deg: 360", "hfov_deg"),
        ("kind: cylindrical, width_m: 3", "width_m"),
        ("kind: fisheye, horizon: 0.5", "horizon"),
        ("kind: cylindrical, horizn: 0.5", "horizn"),
        ("kind: cylindrical, look: down", "look"),
    ],
)
def test_its_keys_are_checked(tmp_path: Path, keys: str, where: str) -> None:
    text = OWN.replace(CAMERA, f"  - {{{keys}}}\n")
    with raises_error(fg.RecipeError, place=f"cameras.0.{where}"):
        fg.load(recipe(tmp_path, text)).validate()


def test_it_is_listed_with_its_page_and_in_the_schema(tmp_path: Path) -> None:
    (entry,) = fg.models("cylindrical")
    assert (entry.kind, entry.description) == ("projection", "a turning slit camera")
    assert "upright lines stay straight" in entry.page
    keys = fg.schema()["$defs"]["Camera"]["properties"]
    assert "horizon" in keys
    assert "cylindrical" in json.dumps(keys["kind"])


def test_a_format_without_words_for_it_refuses_it(tmp_path: Path) -> None:
    text = OWN.replace("formats: []", "formats: [nerfstudio]")
    with raises_error(fg.RecipeError, place="cameras.0.kind"):
        fg.load(recipe(tmp_path, text)).validate()


def test_what_is_no_projection_is_not_registered() -> None:
    with raises_error(fg.RecipeError, place="part"):
        fg.register("projection", "none", "forestgen_plantation:MODEL")


class _Mirrored(Projection):
    """Shows what is on the right on the left."""

    name = "mirrored"
    model = "mirrored"

    class Parameters(CameraKeys):
        default_look: ClassVar = "north"

    def rays(self, camera: Camera, x: Floats, y: Floats) -> Rays:
        toward = np.stack([x, y, np.full(x.shape, 100.0)], axis=-1)
        unit = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
        return Rays(np.zeros(unit.shape), unit, np.ones(x.shape, dtype=bool))

    def project(self, camera: Camera, x: Floats, y: Floats, z: Floats) -> Pixels:
        return Pixels(-100 * x / z, 100 * y / z, np.sqrt(x * x + y * y + z * z), z > 0)


MIRRORED = _Mirrored()


def test_rays_and_image_points_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    fg.register("projection", "mirrored", f"{__name__}:MIRRORED", "left is right")
    text = OWN.replace(CAMERA, "  - {name: round, kind: mirrored, size_px: [40, 20], position_m: [3, 2, 1.5]}\n")
    with raises_error(fg.RecipeError, place="cameras.0.kind"):
        fg.load(recipe(tmp_path, text)).validate()
