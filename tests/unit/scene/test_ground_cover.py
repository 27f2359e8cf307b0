"""Ground cover as geometry: how much of the ground it hides, where it lies and is drawn, and its parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scene_plants import population

from forestgen.core.errors import RecipeError
from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh, triangle_areas
from forestgen.pipeline import assemble_image
from forestgen.plants.exemplar import OrganMesh
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.spectra import load_spectra
from forestgen.scene import ground_cover, ground_view
from forestgen.scene.build import BuiltScene
from forestgen.scene.ground_cover import leaf_shares, local_cover, tile_numbers
from forestgen.scene.ground_layers.fallen_leaves import LAYER as FALLEN
from forestgen.scene.ground_layers.fallen_leaves import _seen
from forestgen.scene.ground_layers.layer import GROUND, Layer, Request, Spread, Thing
from forestgen.scene.ground_layers.moss import LAYER as MOSS
from forestgen.scene.ground_layers.twigs import LAYER as TWIGS
from forestgen.scene.ground_paint import bare_share, painted
from forestgen.scene.ground_tiles import COVERS, MOST_THINGS, VARIANTS, number_per_m2, tile
from forestgen.scene.ground_view import TILE_M, nearest, tiles_before
from forestgen.scene.plan import Plan, check_plan
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera, Material
from forestgen.scene.stem_litter import heaps
from forestgen.scene.terrain import HeightField
from support.error_messages import raises_error
from support.ground_looks import LAYERS, LEAST, MOST, looks

EYE = {"name": "eye", "size_px": [64, 48], "position_m": [5, 1, 1.5], "look_at_m": [5, 9, 0], "hfov_deg": 60}


DATA: dict[str, Any] = {
    "forestgen": 1,
    "seed": 4,
    "species": {"beech": "beech", "spruce": "spruce", "grass": "grass", "willow": "willow"},
    "community": {
        "model": "placed",
        "plants": [
            {"species": "beech", "position_m": [2, 5], "height_m": 6},
            {"species": "spruce", "position_m": [8, 5], "height_m": 6},
        ],
    },
    "cameras": [EYE],
}


def scene(*layers: dict[str, object], **site: object) -> BuiltScene:
    ground = {"kind": "soil_wet", "layers": list(layers)}
    data = {**DATA, "site": {"size_m": [10, 10], "ground": ground, **site}}
    return assemble_image(check_plan(load_recipe_data(data, "test")), Silent(), Timings())


def with_ground(kind: str, *layers: dict[str, object]) -> dict[str, Any]:
    return {**DATA, "site": {"size_m": [10, 10], "ground": {"kind": kind, "layers": list(layers)}}}


def twigs(**more: object) -> Layer:
    keys = TWIGS.Parameters.model_validate({"what": "twigs", **more})
    [layer] = TWIGS.layers(keys, Request(None, {}, {}, 0.002, ()), np.random.default_rng(1))  # type: ignore[arg-type]
    return layer


def squares(side_m: float) -> Layer:
    """A layer of flat squares."""
    corner = 0.5 * side_m * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    up = np.tile(np.array([0, 0, 1], dtype=np.float32), (4, 1))
    mesh = Mesh(corner.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32), up)
    things = (Thing((OrganMesh(Part.LITTER, "twigs-0", mesh),), side_m),)
    return replace(twigs(), things=things, spread=Spread(size_sigma=0.2))


@pytest.mark.parametrize("level", range(len(COVERS)))
def test_a_tile_hides_its_share_of_the_ground(level: int) -> None:
    """Of points at random on tiles side by side, as many lie under a thing as the cover says."""
    layer, rng, hidden = squares(0.05), np.random.default_rng(5), []
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 1, 2) * TILE_M
    for variant in range(VARIANTS):
        made, count = tile(layer, level * VARIANTS + variant, 3)
        corners = made.organs[0].mesh.vertices_m.reshape(-1, 4, 3)[:, :, :2]
        assert len(corners) == count
        middle = (corners.mean(axis=1)[None] + around).reshape(-1, 2)  # neighbours reach in
        along, across = (np.tile(corners[:, k] - corners[:, 0], (9, 1)) for k in (1, 3))
        away = (rng.random((2000, 1, 2)) - 0.5) * TILE_M - middle
        half = 0.5 * np.sum(along**2, axis=1)
        inside = np.maximum(np.abs(np.sum(away * along, axis=2)), np.abs(np.sum(away * across, axis=2))) < half
        hidden.append(inside.any(axis=1).mean())
    assert np.mean(hidden) == pytest.approx(COVERS[level], abs=0.05)


def test_litter_is_heaped_against_stems() -> None:
    """Around the bark, highest there, and higher on the upper side of a slope."""
    layer, dbh_m = replace(squares(0.05), cover=0.9, heaped_m=0.07), 0.4
    found = population(40, np.random.default_rng(2))
    found = replace(found, columns={"dbh_m": np.where(np.arange(40) % 2, dbh_m, 0.0)})
    tiles = np.stack(np.meshgrid(np.arange(50), np.arange(50)), axis=-1).reshape(-1, 2)
    foot = np.array([1.5])
    made, which, transform = heaps(
        layer, tiles, partial(local_cover, layer, seed=3), found, foot, lambda x, y: 0.3 * x + 0.0 * y, 3
    )
    stems = found.position_m[1::2, :2]
    away = transform[:, None, :2, 3] - stems
    apart = np.linalg.norm(away, axis=2)
    nearest = np.argmin(np.abs(apart - 0.75 * dbh_m), axis=1)
    np.testing.assert_allclose(apart[np.arange(len(apart)), nearest], 0.75 * dbh_m)
    assert set(nearest.tolist()) == set(range(20))
    np.testing.assert_allclose(transform[:, 2, 3], 0.3 * transform[:, 0, 3])
    uphill = away[np.arange(len(apart)), nearest, 0] > 0.0
    assert transform[uphill, 2, 2].mean() > 1.5 * transform[~uphill, 2, 2].mean()
    assert not len(heaps(layer, tiles[:0], partial(local_cover, layer, seed=3), found, foot, lambda x, y: x, 3)[2])
    points = np.concatenate([one.mesh.vertices_m for k in set(which.tolist()) for one in made[k].organs])
    near, far = points[points[:, 0] < 0.04, 2], points[points[:, 0] > 0.2, 2]
    assert np.percentile(near, 90) > 2.0 * np.percentile(far, 90)


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
    reach = {length: tiles_before(camera, height, length)[1].max() for length in (0.005, 0.02, 0.08)}
    for length, away in reach.items():
        pixel_m = projection_of(camera).finest_pixel_m(camera, np.array([away]))[0]
        assert 0.9 < min(length / pixel_m, ground_view.FAR_M / away) * ground_view.LEAST_PX < 1.2


def test_an_aircraft_sees_things_of_a_pixel() -> None:
    """40 m of ground from 1 km: all of it, whatever `FAR_M`, and what is larger than 0.1 m alone."""
    from_above = look_at((0.0, 0.0, 1000.0), (0.0, 0.0, 0.0))
    camera = Camera("air", (0.0, 0.0, 1000.0), from_above, (400, 400), 2.2918)
    tiles, _ = tiles_before(camera, HeightField((10.0, 10.0)), 0.5)
    wide = np.ptp(tiles, axis=0) + 1
    assert (wide >= 40).all()
    assert (wide <= 46).all()
    assert len(tiles) == wide.prod()
    assert not len(tiles_before(camera, HeightField((10.0, 10.0)), 0.05)[0])


def test_far_tiles_give_way_when_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    full = scene({"what": "twigs", "cover": 0.5}).spec.instances.outside
    monkeypatch.setattr(ground_cover, "MOST_TILES", full // 2)
    assert 0.3 * full < scene({"what": "twigs", "cover": 0.5}).spec.instances.outside <= full // 2


def test_paint_has_the_mean_colour_of_what_lies_there() -> None:
    stony = scene({"what": "stones", "cover": 0.4})
    bare, covered = scene().spec.terrain.spectrum, stony.spec.terrain.spectrum
    [stones] = ground_cover.ground_cover(stony.plan, stony.population, stony.spec.cameras).layers
    assert bare is not None
    assert covered is not None
    wanted = 0.6 * float(bare.at(650.0)) + 0.4 * float(stones.spectrum.at(650.0))
    assert float(covered.at(650.0)) == pytest.approx(wanted)


def test_moss_and_fallen_needles_are_as_bright_as_measured_floors() -> None:
    built = scene()
    request = Request(built.plan.drawn, built.plan.plants.generators, {"spruce": (1.0, lambda x, y: x)}, 0.01, ())
    [moss] = MOSS.layers(MOSS.Parameters.model_validate({"what": "moss"}), request, np.random.default_rng(1))
    assert moss.spectrum.at(560.0) == pytest.approx(load_spectra("wood/moss")["reflectance"].at(560.0))
    assert 0.079 < float(moss.spectrum.at(560.0)) < 0.095
    keys = FALLEN.Parameters.model_validate({"what": "fallen_leaves"})
    [needles] = FALLEN.layers(keys, request, np.random.default_rng(1))
    measured = load_spectra("ground/litter_needles")["reflectance"]
    for wavelength_nm in (550.0, 600.0, 650.0):
        assert float(needles.spectrum.at(wavelength_nm)) == pytest.approx(float(measured.at(wavelength_nm)), rel=0.25)


def test_a_fallen_leaf_is_as_large_as_the_species_file_says() -> None:
    built = scene()
    request = Request(built.plan.drawn, built.plan.plants.generators, {"beech": (1.0, lambda x, y: x)}, 0.001, ())
    keys = FALLEN.Parameters.model_validate({"what": "fallen_leaves"})
    [layer] = FALLEN.layers(keys, request, np.random.default_rng(1))
    length_m = built.plan.drawn.species["beech"].tissue.leaf_length_m
    lengths = []
    for thing in layer.things:
        points = np.concatenate([one.mesh.vertices_m for one in thing.organs])
        assert thing.length_m == length_m
        lengths.append(np.ptp(points[:, 1]))
    assert max(lengths) < 1.3 * length_m  # with its stalk
    assert min(lengths) > 0.25 * length_m  # a piece
    assert 0.8 * length_m < np.median(lengths)


def test_flat_dark_leaves_lie_below_those_that_are_curled() -> None:
    built = scene()
    request = Request(built.plan.drawn, built.plan.plants.generators, {"beech": (1.0, lambda x, y: x)}, 0.001, ())
    whole, thin = (
        FALLEN.layers(
            FALLEN.Parameters.model_validate({"what": "fallen_leaves", "cover": cover}),
            request,
            np.random.default_rng(1),
        )[0]
        for cover in (0.95, 0.05)
    )
    made = tile(whole, 0, seed=1)[0]
    tops = {one.material: float(one.mesh.vertices_m[:, 2].mean()) for one in made.organs}
    first, *_, last = sorted(tops)
    assert tops[last] < 0.6 * tops[first]
    assert whole.leaf.reflectance[0] > 1.03 * thin.leaf.reflectance[0]  # of what is seen, more lies on top


def test_older_leaves_lie_between_those_that_are_seen_well() -> None:
    """On litter alone, not on its paths and water, once in a recipe; as bright as litter where the eye sees and in the
    near infrared.
    """
    two = [{"what": "fallen_leaves", "cover": cover} for cover in (0.3, 0.5)]
    litter, soil = (check_plan(load_recipe_data(with_ground(kind, *two), "test")) for kind in ("litter", "soil_wet"))
    share = {"beech": (1.0, lambda x, y: x)}

    def found(plan: Plan, pixel_m: float, keys: Any) -> Sequence[Layer]:
        request = Request(plan.drawn, plan.plants.generators, share, pixel_m, ())
        return FALLEN.layers(keys, request, np.random.default_rng(1))

    first, second = litter.drawn.recipe.site.ground.layers
    assert len(found(litter, 0.02, first)) == len(found(soil, 0.002, soil.drawn.recipe.site.ground.layers[0])) == 1
    assert len(found(litter, 0.002, second)) == 1
    for place in ("path", "water", "shore"):
        assert len(found(litter, 0.002, FALLEN.Parameters(what="fallen_leaves", on=place))) == 1
    older, top = found(litter, 0.002, first)
    assert not older.is_painted
    assert older.cover > top.cover
    floor = load_spectra("ground/litter")["reflectance"]
    for wavelength_nm in (600.0, 850.0):
        assert float(older.spectrum.at(wavelength_nm)) == pytest.approx(float(floor.at(wavelength_nm)), rel=0.01)


@pytest.mark.parametrize("name", ["beech", "birch", "oak", "maple", "willow"])
def test_older_leaves_reflect_less_than_all_light(name: str) -> None:
    """Each of them; and in the mean what their layer does. In the near infrared they are more alike than in red."""
    plants = [{"species": name, "position_m": [2, 5], "height_m": 5}]
    data = {**with_ground("litter"), "species": {name: name}, "community": {"model": "placed", "plants": plants}}
    plan = check_plan(load_recipe_data(data, "test"))
    request = Request(plan.drawn, plan.plants.generators, {name: (1.0, lambda x, y: x)}, 0.001, ())
    keys = FALLEN.Parameters.model_validate({"what": "fallen_leaves"})
    older, _ = FALLEN.layers(keys, request, np.random.default_rng(1))
    assert number_per_m2(older, np.array(older.cover)) * TILE_M**2 < MOST_THINGS
    spectra = [one.reflectance_spectrum for one in older.materials.values()]
    grid = np.arange(400.0, 2501.0, 10.0)
    values = np.array([one.at(grid) for one in spectra if one is not None])
    assert values.max() < 0.9
    share = _seen(older.things, list(older.materials), older.cover)
    assert older.leaf.reflectance_spectrum is not None
    np.testing.assert_allclose(share @ values / share.sum(), older.leaf.reflectance_spectrum.at(grid), rtol=1e-6)
    red, infrared = (np.ptp(values[:, grid == one]) / values[:, grid == one].mean() for one in (600.0, 850.0))
    assert infrared < 0.4 * red


@pytest.mark.parametrize("size_m", [0.3, 1.0, 3.0])
def test_large_things_are_as_many_as_their_cover_asks_for(size_m: float) -> None:
    """Expected numbers over seeds: cover 0.02 of what a downward camera of 60 m sees."""
    camera = {"name": "a", "kind": "orthographic", "size_px": [600, 600], "width_m": 60}
    camera |= {"position_m": [5, 5, 50], "look": "down"}
    found, wanted = [], 0.0
    for seed in range(3):
        data = {**DATA, "seed": seed, "cameras": [camera]}
        data["site"] = {"size_m": [10, 10], "ground": {"layers": [{"what": "stones", "size_m": size_m, "cover": 0.02}]}}
        built = assemble_image(check_plan(load_recipe_data(data, "test")), Silent(), Timings())
        stones = built.spec.instances.at(slice(len(built.spec.instances.on_site), None))
        inside = np.abs(stones.transform[:, :2, 3] - 5.0).max(axis=1) < 29.0
        area_m2 = np.abs(np.linalg.det(stones.transform[inside, :2, :2]))
        made = [built.spec.exemplars[one] for one in stones.exemplar[inside]]
        shadow = [0.5 * sum(flat_area(organ.mesh) for organ in one.organs) for one in made]
        found.append(float(np.sum(area_m2 * shadow)))
        wanted += -np.log(0.98) * 58.0**2
    assert sum(found) == pytest.approx(wanted, rel=0.35)


def flat_area(mesh: Mesh) -> float:
    return float(triangle_areas(mesh.vertices_m * np.array([1, 1, 0], dtype=np.float32), mesh.faces).sum())


def test_a_camera_of_parallel_rays_sees_the_tiles_where_it_looks() -> None:
    height = HeightField((10.0, 10.0))
    place, target = (5.0, -300.0, 300.0), (5.0, 5.0, 0.0)
    oblique = Camera("o", place, look_at(place, target), (400, 300), 0.0, projection="orthographic", width_m=40.0)
    at, _ = tiles_before(oblique, height, 0.3)
    assert np.abs((at + 0.5).mean(axis=0) - 5.0).max() < 2.0
    assert 40 * 40 < len(at) < 60 * 70  # 40 m by 30 m, seen at 45 degrees
    wide = replace(oblique, width_m=1e5, size_px=(10, 10))
    assert len(tiles_before(wide, height, 1e5)[0]) <= 403**2


def test_the_nearest_tiles_are_kept() -> None:
    first, second = nearest([np.array([3.0, 1.0, 1.0]), np.array([2.0, 1.0])], 2)
    assert first.tolist() == [False, True, True]
    assert not second.any()


NOWHERE = (np.zeros((0, 2), np.intp),) * 2


def test_ground_is_bare_where_things_lie_on_it() -> None:
    """The share of the layers' depth that is drawn on the tiles around a place, by hand."""
    thin, dense = (replace(twigs(), name=f"{cover}/x", cover=cover) for cover in (0.2, 0.8))
    near, far = np.array([[0, 0], [1, 0]]), np.array([[x, y] for x in range(-3, 4) for y in range(-3, 4)])
    own = np.log([0.8, 0.2]) / np.log(0.16)
    places = np.array([[0.5, 0.5], [2.0, 0.5], [2.0, 1.0], [2.5, 2.5], [4.0, 0.5], [9.0, 9.0]])
    found = bare_share(places, (thin, dense), (near, far))
    expected = [1.0, own[1] + 0.5 * own[0], own[1] + 0.25 * own[0], own[1], 0.5 * own[1], 0.0]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert not bare_share(places, (thin, dense), NOWHERE).any()


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYERS)
def test_geometry_and_paint_look_alike(name: str) -> None:
    """In five bands; benchmarks/ground_cover.py prints more covers and suns."""
    ratio = looks(LAYERS[name] | {"cover": 0.5}, 40.0, 32).ratio
    assert np.all((ratio > LEAST) & (ratio < MOST)), ratio


def test_species_whose_leaves_lie_among_each_other_share_the_paint() -> None:
    terrain = scene().spec.terrain
    red, blue = (replace(twigs(), name=f"0/{one}", cover=0.6, leaf=flat(one)) for one in (0.2, 0.6))
    both, other = (painted(terrain, pair, NOWHERE).spectrum for pair in ((red, blue), (blue, red)))
    assert both is not None
    assert other is not None
    assert float(both.at(550.0)) == pytest.approx(float(other.at(550.0)))


def flat(value: float) -> Material:
    spectrum = Spectrum(np.array([300.0, 2600.0]), np.full(2, value))
    return Material((value, value, value), reflectance_spectrum=spectrum)


def test_what_is_not_as_the_recipe_says_is_noted() -> None:
    small = scene({"what": "twigs", "length_m": 0.02, "cover": 0.5})
    assert any("hide at most" in note for note in small.notes)
    data = {**DATA, "community": {"model": "placed"}}
    data["site"] = {"size_m": [10, 10], "ground": {"layers": [{"what": "fallen_leaves"}]}}
    bare = assemble_image(check_plan(load_recipe_data(data, "test")), Silent(), Timings())
    assert any("nothing lies there" in note for note in bare.notes)


@pytest.mark.parametrize(
    ("layer", "key"),
    [
        ({"what": "snow_flakes"}, "what"),
        ({"what": "twigs", "cover": 1.0}, "cover"),
        ({"what": "stones", "size_m": -1}, "size_m"),
        ({"what": "small_plants", "species": "gras"}, "species"),
        ({"what": "small_plants"}, "species"),
        ({"what": "small_plants", "species": "willow"}, "species"),
    ],
)
def test_wrong_keys_are_refused_by_their_place(layer: dict[str, object], key: str) -> None:
    with raises_error(RecipeError, place=f"site.ground.layers.0.{key}"):
        scene(layer)
