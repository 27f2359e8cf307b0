from __future__ import annotations

import io
from dataclasses import replace

import laspy
import numpy as np
import pytest
import trimesh
from dataset_shots import HEIGHT, SETTINGS, WIDTH, make_shot
from PIL import Image

from forestgen.core.parts import Part
from forestgen.dataset import png
from forestgen.dataset.formats import points
from forestgen.dataset.tonemap import preview_of


def placed(labelled, offset_m=(0.0, 0.0, 0.0), spread_m=50.0):
    """The same frame with positions spread over some metres."""
    rng = np.random.default_rng(3)
    surface = labelled.frame.surface
    position = rng.uniform(-spread_m, spread_m, surface.position_m.shape) + np.asarray(offset_m)
    position[surface.part == Part.NOTHING] = np.nan
    surface = replace(surface, position_m=position.astype(np.float32))
    return replace(labelled, frame=replace(labelled.frame, surface=surface))


def write(folder, labelled, **settings):
    folder.mkdir(exist_ok=True)
    points.FORMAT.write_frame(folder, labelled, replace(SETTINGS, **settings))
    return folder / "points.ply", folder / "points.laz"


def ply_records(path):
    """Vertices of a PLY file, as trimesh reads them."""
    raw = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]
    return raw["data"]


@pytest.mark.parametrize("stride", [1, 3])
def test_both_files_hold_what_the_pixels_see(tmp_path, wide_shot, stride):
    labelled = placed(wide_shot.labelled)
    surface = labelled.frame.surface
    ply, laz = write(tmp_path, labelled, point_stride=stride)
    vertices, cloud = ply_records(ply), laspy.read(laz)
    y, x = np.mgrid[0:HEIGHT:stride, 0:WIDTH:stride].reshape(2, -1)
    seen = surface.part[y, x] != Part.NOTHING
    y, x = y[seen], x[seen]
    assert 0 < len(x) < HEIGHT * WIDTH
    np.testing.assert_array_equal(vertices["row"], y)
    np.testing.assert_array_equal(vertices["column"], x)
    position = np.stack([vertices[axis] for axis in "xyz"], axis=1)
    np.testing.assert_array_equal(position, surface.position_m[y, x].astype(np.float64))
    np.testing.assert_array_equal(np.stack([vertices[n] for n in ("nx", "ny", "nz")], axis=1), surface.normal[y, x])
    assert cloud.header.scales.max() <= 1e-4
    np.testing.assert_allclose(cloud.xyz, position, rtol=0, atol=0.5001e-4)
    for name, values in (("plant_id", surface.plant_id[y, x]), ("part", surface.part[y, x])):
        np.testing.assert_array_equal(vertices[name], values)
        np.testing.assert_array_equal(cloud[name], values)
    assert cloud.plant_id.dtype == np.uint32
    assert cloud.plant_id.max() > 2**31
    np.testing.assert_array_equal(cloud.species, vertices["species"])


def test_colours_are_the_previews(tmp_path, shot):
    ply, laz = write(tmp_path, placed(shot.labelled))
    png.write_png(tmp_path / "preview.png", preview_of(shot.frame.radiance).picture)
    with Image.open(tmp_path / "preview.png") as picture:
        preview = np.asarray(picture)
    vertices, cloud = ply_records(ply), laspy.read(laz)
    rgb = preview[vertices["row"], vertices["column"]]
    for i, name in enumerate(("red", "green", "blue")):
        np.testing.assert_array_equal(vertices[name], rgb[:, i])
        np.testing.assert_array_equal(cloud[name] // 257, rgb[:, i])
        np.testing.assert_array_equal(cloud[name] % 257, 0)


def test_species_are_numbered_as_in_the_recipe(tmp_path, shot):
    vertices = ply_records(write(tmp_path, placed(shot.labelled))[0])
    population = shot.population
    recipe = {"poplar": 1, "spruce": 2, "oak": 3}
    number = {0: 0} | {
        plant: recipe[population.species_names[k]]
        for plant, k in zip(population.plant_id.tolist(), population.species, strict=True)
    }
    assert vertices["species"].tolist() == [number[plant] for plant in vertices["plant_id"].tolist()]
    assert set(vertices["species"].tolist()) == {0, 1, 3}


def test_classes_are_aspr_s_by_height_above_the_stem_base(tmp_path, shot):
    labelled = placed(shot.labelled)
    surface, plant_id = labelled.frame.surface, shot.population.plant_id
    base_z = labelled.measures.stem_base_m[:, 2]
    row = np.searchsorted(plant_id, surface.plant_id)
    heights = np.resize([-1.0, 0.29, 0.31, 1.99, 2.01, 20.0], surface.part.shape)
    position = surface.position_m.copy()
    position[..., 2] = np.where(surface.plant_id > 0, base_z[np.minimum(row, len(plant_id) - 1)] + heights, 4.0)
    part = surface.part.copy()
    ground = np.argwhere(part == Part.GROUND)
    for k, kind in enumerate((Part.WATER, Part.ROCK, Part.LITTER)):
        part[tuple(ground[k])] = kind
    surface = replace(surface, position_m=position, part=part)
    _, laz = write(tmp_path, replace(labelled, frame=replace(labelled.frame, surface=surface)))
    cloud = laspy.read(laz)
    expected = np.resize([3, 3, 4, 4, 5, 5], part.shape)
    expected[surface.plant_id == 0] = 2
    expected[part == Part.WATER] = 9
    np.testing.assert_array_equal(cloud.classification, expected[part != Part.NOTHING])
    assert set(np.unique(cloud.classification)) == {2, 3, 4, 5, 9}


def test_far_from_the_origin_and_wide_apart(tmp_path, shot):
    for offset, spread, step in (((1e5, -2e5, 300.0), 50.0, 1e-4), ((0.0, 0.0, 0.0), 2e5, 1e-3)):
        labelled = placed(shot.labelled, offset, spread)
        cloud = laspy.read(write(tmp_path, labelled)[1])
        seen = labelled.frame.surface.position_m[labelled.frame.surface.part != Part.NOTHING].astype(np.float64)
        np.testing.assert_allclose(cloud.header.scales, step)
        np.testing.assert_allclose(cloud.xyz, seen, rtol=0, atol=step * 0.51)


def test_sky_alone_gives_valid_empty_files(tmp_path):
    shot = make_shot([9])
    surface = shot.frame.surface
    surface = replace(surface, part=np.zeros_like(surface.part), plant_id=np.zeros_like(surface.plant_id))
    ply, laz = write(tmp_path, replace(shot.labelled, frame=replace(shot.frame, surface=surface)))
    assert len(laspy.read(laz).points) == 0
    header = ply.read_bytes()
    assert b"element vertex 0\n" in header
    assert header.endswith(b"end_header\n")
    trimesh.load(ply)  # does not raise


def test_equal_input_gives_equal_bytes_without_a_date(tmp_path, shot):
    labelled = placed(shot.labelled)
    first, second = write(tmp_path / "a", labelled), write(tmp_path / "b", labelled)
    points.FORMAT.merge(tmp_path, [tmp_path / "a", tmp_path / "b"], SETTINGS)
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
    with laspy.open(io.BytesIO(first[1].read_bytes())) as reader:
        assert reader.header.creation_date is None
        assert reader.header.are_points_compressed
        assert str(reader.header.version) == "1.4"


def test_time_is_the_cameras(tmp_path, shot):
    camera = replace(shot.frame.camera, time_s=1.25)
    labelled = replace(placed(shot.labelled), frame=replace(placed(shot.labelled).frame, camera=camera))
    assert set(laspy.read(write(tmp_path, labelled)[1]).gps_time.tolist()) == {1.25}
