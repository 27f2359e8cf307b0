"""Cloud sources, skies, terrains and grounds of other packages are used like those that come along."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import forestgen as fg
from forestgen.community.simulation import final_population
from forestgen.core import registry
from forestgen.core.progress import Silent, Timings
from forestgen.recipe.load import load_recipe
from forestgen.recipe.registries import CLOUD_SOURCES, GROUND_COVERS, SKIES, TERRAINS
from forestgen.render.light import sky_map
from forestgen.render.variant import using
from forestgen.scene.build import build_scene
from forestgen.scene.colour import RGB
from forestgen.scene.plan import estimate_bytes, make_plan
from forestgen.scene.spec import SceneSpec
from support.error_messages import raises_error

ROOT = Path(__file__).parents[2]
RECIPE = """\
forestgen: 1
site: {size_m: [20, 30]}
species: {fireweed: }
community: {model: uniform, plants: {fireweed: {count: 3}}}
cameras: [{position_m: [10, -4, 3], size_px: [24, 16]}]
"""


@pytest.fixture(autouse=True)
def _as_before(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What a test registers is forgotten."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "plugin"))
    registries = (CLOUD_SOURCES, SKIES, TERRAINS, GROUND_COVERS)
    before, registered = [dict(one._entries) for one in registries], list(registry._registered)
    yield
    for one, entries in zip(registries, before, strict=True):
        one._entries.clear()
        one._entries.update(entries)
    registry._registered[:] = registered


def scene(tmp_path: Path, *overrides: str) -> SceneSpec:
    path = tmp_path / "stand.yaml"
    path.write_text(RECIPE)
    plan = make_plan(load_recipe(path, overrides).draw(0))
    assert estimate_bytes(plan)["clouds"] > 0
    return build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings()).spec


def test_an_examples_cloud_source_reaches_the_scene(tmp_path: Path) -> None:
    fg.register("cloud_source", "grey_layer", "forestgen_plantation.grey_layer:SOURCE", "a grey layer of cloud")
    (entry,) = fg.models("grey_layer")
    assert (entry.kind, entry.page.splitlines()[0][:12]) == ("cloud_source", "A grey layer")
    assert '"optical_depth"' in json.dumps(fg.schema())
    grid = scene(tmp_path, "sky.clouds={type: grey_layer, base_m: 700, optical_depth: 5}").clouds
    assert grid is not None
    np.testing.assert_allclose(grid.extinction_per_m.sum(axis=0) * grid.cell_m[2], 5.0, rtol=1e-6)
    assert (grid.low_m[2], grid.high_m[2]) == (700.0, 900.0)
    assert (grid.low_m[0] + grid.high_m[0], grid.low_m[1] + grid.high_m[1]) == (20.0, 30.0)


def test_its_keys_and_its_base_are_checked(tmp_path: Path) -> None:
    fg.register("cloud_source", "grey_layer", "forestgen_plantation.grey_layer:SOURCE")
    with raises_error(fg.RecipeError, place="sky.clouds.optical_depth"):
        scene(tmp_path, "sky.clouds={type: grey_layer, optical_depth: 500}")
    with raises_error(fg.RecipeError, place="sky.clouds.cover"):
        scene(tmp_path, "sky.clouds={type: grey_layer, cover: 0.5}")
    with raises_error(fg.RecipeError, place="cameras.0.position_m"):
        scene(tmp_path, "sky.clouds={type: grey_layer, base_m: 2}", "render.clouds=farfield")


def test_terrain_ground_and_sky_of_another_package(tmp_path: Path) -> None:
    for kind, name, attribute in (
        ("terrain", "valley", "VALLEY"),
        ("ground_cover", "stripes", "STRIPES"),
        ("sky_model", "even", "EVEN"),
    ):
        fg.register(kind, name, f"own_sky_parts:{attribute}")
    fg.register("cloud_source", "grey_layer", "forestgen_plantation.grey_layer:SOURCE")
    own = ("site.terrain={kind: valley, slope: 0.2}", "site.ground=stripes", "sky.kind=even", "sky.clouds=grey_layer")
    bright, dull = (scene(tmp_path, *own, f"sky.share={share}") for share in (1.0, 0.25))
    x, _, z = bright.terrain.mesh.vertices_m.T
    np.testing.assert_allclose(z, 0.2 * np.abs(np.clip(x, 0, 20) - 10), atol=1e-5)
    np.testing.assert_allclose(bright.terrain.texture[0, 0] / bright.terrain.texture[1, 0], 0.5, rtol=1e-5)
    with using("scalar_rgb"):
        maps = [sky_map(one.sky, RGB) for one in (bright, dull)]
    assert np.ptp(maps[0][:60], axis=(0, 1)).max() == 0
    np.testing.assert_allclose(maps[1], 0.25 * maps[0], rtol=1e-5)
