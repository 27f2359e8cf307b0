"""Ground cover as geometry: how much of the ground it hides, where it lies and is drawn, and its parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.geometry.mesh import Mesh
from forestgen.pipeline import assemble_image
from forestgen.plants.exemplar import OrganMesh
from forestgen.recipe.load import load_recipe_data
from forestgen.scene import ground_cover
from forestgen.scene.build import BuiltScene
from forestgen.scene.ground_cover import (
    COVERS,
    GROUND,
    TILE_M,
    VARIANTS,
    _tile,
    _tiles_before,
    leaf_shares,
    local_cover,
    tile_numbers,
)
from forestgen.scene.ground_layers.fallen_leaves import LAYER as FALLEN
from forestgen.scene.ground_layers.layer import Layer, Request, Thing
from forestgen.scene.ground_layers.stones import LAYER as STONES
from forestgen.scene.ground_layers.twigs import LAYER as TWIGS
from forestgen.scene.plan import check_plan
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera
from forestgen.scene.terrain import HeightField
from support.error_messages import raises_error

EYE = {"name": "eye", "size_px": [64, 48], "position_m": [5, 1, 1.5], "look_at_m": [5, 9, 0], "hfov_deg": 60}


def scene(*layers: dict[str, object], camera: dict[str, object] = EYE, **site: object) -> BuiltScene:
    plants = [
        {"species": "beech", "position_m": [2, 5], "height_m": 6},
        {"species": "spruce", "position_m": [8, 5], "height_m": 6},
    ]
    data = {
        "forestgen": 1,
        "seed": 4,
        "species": {"beech": "beech", "spruce": "spruce", "grass": "grass"},
        "site": {"size_m": [10, 10], "ground": {"kind": "soil_wet", "layers": list(layers)}, **site},
        "community": {"model": "placed", "plants": plants},
        "cameras": [camera],
    }
    return assemble_image(check_plan(load_recipe_data(data, "test")), Silent(), Timings())


def twigs(**more: object) -> Layer:
    keys = TWIGS.Parameters.model_validate({"what": "twigs", **more})
    [layer] = TWIGS.layers(keys, Request(None, {}, {}, 0.002, ()), np.random.default_rng(1))  # type: ignore[arg-type]
    return layer


def squares(side_m: float) -> Layer:
    """A layer of flat squares."""
    corner = 0.5 * side_m * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    up = np.tile(np.array([0, 0, 1], dtype=np.float32), (4, 1))
    mesh = Mesh(corner.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32), up)
    return replace(twigs(), things=(Thing((OrganMesh(Part.LITTER, "twigs-0", mesh),), side_m),))


@pytest.mark.parametrize("level", range(len(COVERS)))
def test_a_tile_hides_its_share_of_the_ground(level: int) -> None:
    """Of points at random on tiles side by side, as many lie under a thing as the cover says."""
    layer, rng, hidden = squares(0.12), np.random.default_rng(5), []
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 1, 2) * TILE_M
    for variant in range(VARIANTS):
        tile, count = _tile(layer, level * VARIANTS + variant, 3)
        corners = tile.organs[0].mesh.vertices_m.reshape(-1, 4, 3)[:, :, :2]
        assert len(corners) == count
        middle = (corners.mean(axis=1)[None] + around).reshape(-1, 2)  # neighbours reach in
        along, across = (np.tile(corners[:, k] - corners[:, 0], (9, 1)) for k in (1, 3))
        away = (rng.random((2000, 1, 2)) - 0.5) * TILE_M - middle
        half = 0.5 * np.sum(along**2, axis=1)
        inside = np.maximum(np.abs(np.sum(away * along, axis=2)), np.abs(np.sum(away * across, axis=2))) < half
        hidden.append(inside.any(axis=1).mean())
    assert np.mean(hidden) == pytest.approx(COVERS[level], abs=0.05)


@pytest.mark.parametrize("cover", [0.05, 0.3, 0.7])
@pytest.mark.parametrize("patch_m", [None, 2.0])
def test_the_mean_cover_is_the_recipes(cover: float, patch_m: float | None) -> None:
    layer = replace(twigs(), cover=cover, patch_m=patch_m)
    middle = np.stack(np.meshgrid(np.arange(300.0), np.arange(300.0)), axis=-1).reshape(-1, 2)
    found = local_cover(layer, middle, 1)
    assert found.mean() == pytest.approx(cover, rel=0.08)
    assert (found.std() > 0.1 * cover) == (patch_m is not None)


def test_tiles_are_drawn_by_their_place_alone() -> None:
    at = np.array([[-3, 4], [0, 0], [7, -2]])
    one, other = tile_numbers(at, 9), tile_numbers(at[::-1], 9)[::-1]
    np.testing.assert_array_equal(one, other)
    many = tile_numbers(np.stack(np.meshgrid(np.arange(-50, 50), np.arange(-50, 50)), axis=-1).reshape(-1, 2), 9)
    assert np.abs(many.mean(axis=0) - 0.5).max() < 0.01
    assert np.abs(np.corrcoef(many.T) - np.eye(3)).max() < 0.03


def test_fallen_leaves_lie_below_their_trees() -> None:
    built = scene()
    shares = leaf_shares(built.population, (10.0, 10.0))
    assert sum(share for share, _ in shares.values()) == pytest.approx(1.0)
    places = np.array([2.0, 8.0]), np.array([5.0, 5.0])  # of the beech and the spruce
    beech, spruce = (share * where(*places) for share, where in shares.values())
    np.testing.assert_allclose(beech + spruce, 1.0)
    assert beech[0] > 1.3 * beech[1]
    assert spruce[1] > 1.1 * spruce[0]


def test_the_ground_has_its_parts_and_no_plants() -> None:
    layers = [
        {"what": "fallen_leaves", "cover": 0.6},
        {"what": "stones", "cover": 0.1},
        {"what": "moss", "cover": 0.2},
        {"what": "small_plants", "species": "grass", "height_m": 0.15, "cover": 0.1},
    ]
    built, bare = scene(*layers), scene()
    spec = built.spec
    count = len(bare.spec.instances)
    assert len(spec.instances.on_site) == len(bare.spec.instances.on_site)
    assert not spec.instances.plant_id[count:].any()
    tiles = {int(one) for one in spec.instances.exemplar[count:]}
    parts = {organ.part for one in tiles for organ in spec.exemplars[one].organs}
    assert parts == {Part.LITTER, Part.ROCK, Part.MOSS, Part.GROUND_PLANTS}
    assert all(spec.exemplars[one].species == GROUND for one in tiles)
    assert {(GROUND, organ.material) for one in tiles for organ in spec.exemplars[one].organs} <= set(spec.materials)
    assert built.population.species_names == bare.population.species_names


def test_the_same_recipe_has_the_same_ground() -> None:
    one, other = (scene({"what": "twigs", "cover": 0.2, "patch_m": 1}).spec.instances for _ in range(2))
    np.testing.assert_array_equal(one.transform, other.transform)
    np.testing.assert_array_equal(one.exemplar, other.exemplar)


def test_tiles_lie_on_the_ground() -> None:
    """On a plane that rises, exactly: corners of a tile are on it."""
    built = scene({"what": "twigs", "cover": 0.5}, terrain={"kind": "rolling", "amplitude_m": 0.5, "wavelength_m": 30})
    height = built.plan.views.height
    tiles = built.spec.instances.at(slice(len(built.spec.instances.on_site), None))
    near = tiles.transform[np.hypot(*(tiles.transform[:, :2, 3] - 5).T) < 6]
    for corner in ([-0.5, -0.5, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0]):
        at = near[:, :, :3] @ corner + near[:, :, 3]
        assert np.abs(at[:, 2] - height(*at[:, :2].T)).max() < 0.02


def test_things_are_drawn_while_they_are_larger_than_a_pixel() -> None:
    camera = Camera("eye", (0.0, 0.0, 1.5), look_at((0.0, 0.0, 1.5), (0.0, 9.0, 0.0)), (640, 480), 60.0)
    height = HeightField((10.0, 10.0))
    reach = {length: _tiles_before(camera, height, length)[1].max() for length in (0.005, 0.02, 0.08)}
    for length, away in reach.items():
        pixel_m = projection_of(camera).finest_pixel_m(camera, np.array([away]))[0]
        assert 0.9 < min(length / pixel_m, ground_cover.FAR_M / away) * ground_cover.LEAST_PX < 1.2


def test_far_tiles_give_way_when_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    full = scene({"what": "twigs", "cover": 0.5}).spec.instances.outside
    monkeypatch.setattr(ground_cover, "MOST_TILES", full // 2)
    assert 0.3 * full < scene({"what": "twigs", "cover": 0.5}).spec.instances.outside <= full // 2 + 1


def test_paint_has_the_mean_colour_of_what_lies_there() -> None:
    bare, covered = scene().spec.terrain.spectrum, scene({"what": "stones", "cover": 0.4}).spec.terrain.spectrum
    keys = STONES.Parameters.model_validate({"what": "stones"})
    [stones] = STONES.layers(keys, Request(None, {}, {}, 0.01, ()), np.random.default_rng(1))  # type: ignore[arg-type]
    assert bare is not None
    assert covered is not None
    wanted = 0.6 * float(bare.at(650.0)) + 0.4 * float(stones.spectrum.at(650.0))
    assert float(covered.at(650.0)) == pytest.approx(wanted)


def test_a_fallen_leaf_is_as_large_as_the_species_file_says() -> None:
    built = scene()
    request = Request(built.plan.drawn, built.plan.plants.generators, {"beech": (1.0, lambda x, y: x)}, 0.001, ())
    keys = FALLEN.Parameters.model_validate({"what": "fallen_leaves"})
    [layer] = FALLEN.layers(keys, request, np.random.default_rng(1))
    length_m = built.plan.drawn.species["beech"].tissue.leaf_length_m
    for thing in layer.things:
        points = np.concatenate([one.mesh.vertices_m for one in thing.organs])
        assert thing.length_m == length_m
        assert 0.5 * thing.length_m < np.ptp(points[:, 1]) < 1.3 * thing.length_m  # curled, and with its stalk


@pytest.mark.parametrize(
    ("layer", "key"),
    [
        ({"what": "snow_flakes"}, "what"),
        ({"what": "twigs", "cover": 1.0}, "cover"),
        ({"what": "stones", "size_m": -1}, "size_m"),
        ({"what": "small_plants", "species": "gras"}, "species"),
        ({"what": "small_plants"}, "species"),
    ],
)
def test_wrong_keys_are_refused_by_their_place(layer: dict[str, object], key: str) -> None:
    with raises_error(RecipeError, place=f"site.ground.layers.0.{key}"):
        scene(layer)
