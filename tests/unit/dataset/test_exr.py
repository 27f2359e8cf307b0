from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from dataset_shots import HEIGHT, WIDTH, make_camera, make_shot

from forestgen.core.errors import OutputError
from forestgen.core.spectrum import Band, Spectrum
from forestgen.dataset import exr
from forestgen.dataset.camera import camera_from_world, world_to_camera, world_to_ndc
from forestgen.dataset.check import light
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.exr import read_exr, read_exr_attributes, write_exr
from forestgen.dataset.tonemap import centre_nm, width_nm
from forestgen.labels.channels.boundaries import occlusion_boundaries
from forestgen.recipe.registries import DEFAULT_CHANNELS
from forestgen.render.frame import Radiance
from forestgen.scene.projection import projection_of
from support.error_messages import raises_error

POINTS = (
    np.random.default_rng(0).uniform(-5, 5, (50, 3)) + np.array([3.0, -4.0, 12.0]) + 40 * np.array([0.6, 0.7, -0.2])
)


GEOMETRY = {"normal", "normal.camera", "normal.shading", "normal.shading.camera", "position", "position.camera"}


def written(path, shot, **attributes):
    write_exr(path, shot.labelled, attributes)
    return path


def test_every_value_survives(tmp_path, wide_shot):
    parts = read_exr(written(tmp_path / "a.exr", wide_shot))
    labelled, frame = wide_shot.labelled, wide_shot.frame
    surface, labels = frame.surface, labelled.pixels
    rotation = frame.camera.world_from_camera
    expected = {
        "radiance": dict(zip("RGB", np.moveaxis(frame.radiance.mean, -1, 0), strict=True)),
        "radiance.denoised": dict(zip("RGB", np.moveaxis(frame.radiance.denoised, -1, 0), strict=True)),
        "radiance.variance": dict(zip("RGB", np.moveaxis(frame.radiance.variance, -1, 0), strict=True)),
        "depth": {"Z": surface.depth_m, "distance": surface.distance_m},
        "normal": dict(zip("XYZ", np.moveaxis(surface.normal, -1, 0), strict=True)),
        "normal.camera": dict(zip("XYZ", np.moveaxis((surface.normal @ rotation), -1, 0), strict=True)),
        "normal.shading": dict(zip("XYZ", np.moveaxis(surface.shading_normal, -1, 0), strict=True)),
        "normal.shading.camera": dict(zip("XYZ", np.moveaxis(surface.shading_normal @ rotation, -1, 0), strict=True)),
        "position": dict(zip("XYZ", np.moveaxis(surface.position_m, -1, 0), strict=True)),
        "albedo": dict(zip("RGB", np.moveaxis(surface.albedo, -1, 0), strict=True)),
        "sun": {"visible": surface.sun_visible},
        "cloud": {"opacity": frame.cloud_opacity},
        "motion": {"forward.u": frame.motion_px[..., 0], "forward.v": frame.motion_px[..., 1]},
        "boundary": {"occluding": occlusion_boundaries(surface, frame.camera)},
        "identity": {
            "plant_id": labels.instance, "part": labels.part, "semantic": labels.semantic,
            "centre.plant_id": surface.plant_id, "centre.part": surface.part,
            "centre.exemplar": surface.exemplar, "centre.face": surface.face,
        },
        "coverage": {
            **{f"rank{k}.id": labels.ranks.plant_id[..., k] for k in range(8)},
            **{f"rank{k}.coverage": labels.ranks.coverage[..., k] for k in range(8)},
        },
    }  # fmt: skip
    assert set(parts) == {*expected, "position.camera"}
    for name, channels in expected.items():
        assert set(parts[name]) == set(channels)
        for channel, values in channels.items():
            kind = np.float32 if np.issubdtype(values.dtype, np.floating) else np.uint32
            assert parts[name][channel].dtype == kind
            np.testing.assert_array_equal(parts[name][channel], values.astype(kind))
    assert labels.instance.max() > 2**31
    assert np.isnan(parts["motion"]["forward.u"][0, 0])


def test_camera_positions_are_rays_times_depth(tmp_path, shot):
    parts = read_exr(written(tmp_path / "a.exr", shot))
    seen = np.stack([parts["position.camera"][axis] for axis in "XYZ"], axis=-1)
    depth = parts["depth"]["Z"]
    sky = np.isinf(depth)
    assert 0 < sky.sum() < sky.size
    assert np.isnan(seen[sky]).all()
    np.testing.assert_array_equal(seen[~sky, 2], depth[~sky])
    pixel = seen[~sky].astype(float) @ projection_of(shot.frame.camera).intrinsics(shot.frame.camera).T
    y, x = np.nonzero(~sky)
    np.testing.assert_allclose(pixel[:, :2] / pixel[:, 2:], np.stack([x, y], axis=1) + 0.5, atol=1e-4)


def test_camera_normals_are_in_opencv_axes(tmp_path, shot):
    right, _, forward = shot.frame.camera.world_from_camera.T
    normal = np.broadcast_to(-forward, shot.frame.surface.normal.shape).astype(np.float32)
    surface = replace(shot.frame.surface, normal=normal, shading_normal=np.broadcast_to(right, normal.shape))
    frame = replace(shot.frame, surface=surface)
    write_exr(tmp_path / "a.exr", replace(shot.labelled, frame=frame), {})
    parts = read_exr(tmp_path / "a.exr")
    for name, expected in (("normal.camera", (0, 0, -1)), ("normal.shading.camera", (1, 0, 0))):
        for axis, value in zip("XYZ", expected, strict=True):
            np.testing.assert_allclose(parts[name][axis], value, atol=1e-6)


@pytest.mark.parametrize(
    ("channels", "missing"),
    [
        (set(DEFAULT_CHANNELS) - {"surface"}, GEOMETRY),
        (set(DEFAULT_CHANNELS) - {"albedo", "sun"}, {"albedo", "sun"}),
        (set(), {*GEOMETRY, "albedo", "sun", "cloud", "motion", "boundary", "coverage"}),
    ],
)
def test_only_what_the_recipe_asks_for(tmp_path, shot, channels, missing):
    everything = set(read_exr(written(tmp_path / "a.exr", shot)))
    labelled = replace(shot.labelled, channels=frozenset(channels))
    write_exr(tmp_path / "b.exr", labelled, {})
    parts = read_exr(tmp_path / "b.exr")
    assert set(parts) == everything - missing
    assert ("centre.plant_id" in parts["identity"]) == ("surface" in channels)


def test_what_a_frame_has_not_is_left_out(tmp_path, shot):
    frame = replace(shot.frame, cloud_opacity=None, motion_px=None)
    write_exr(tmp_path / "a.exr", replace(shot.labelled, frame=frame), {})
    assert not {"cloud", "motion"} & set(read_exr(tmp_path / "a.exr"))


@pytest.mark.parametrize("tool", ["exrheader", "exrinfo"])
def test_openexrs_own_tools_read_it(tmp_path, shot, tool):
    program = shutil.which(tool)
    if program is None:
        pytest.skip(f"{tool} is not installed (Debian: openexr)")
    path = written(tmp_path / "a.exr", shot)
    told = subprocess.run([program, str(path)], capture_output=True, text=True, check=True).stdout
    assert all(name in told for name in read_exr(path))


def test_without_denoising(tmp_path):
    assert "radiance.denoised" not in read_exr(written(tmp_path / "a.exr", make_shot([1, 2], denoised=False)))


def test_attributes(tmp_path, shot):
    header = read_exr_attributes(written(tmp_path / "a.exr", shot, recipe_hash="abc", seed="7"))
    camera = shot.frame.camera
    assert header["forestgen/recipe_hash"] == "abc"
    assert header["forestgen/seed"] == "7"
    names = json.loads(header["forestgen/classes"])
    assert names == {"0": "nothing", "1": "ground", "2": "poplar", "3": "spruce", "4": "oak"}
    assert json.loads(header["forestgen/parts"])["7"] == "dead_wood"
    model = json.loads(header["forestgen/camera"])
    np.testing.assert_array_equal(model["K"], projection_of(camera).intrinsics(camera))
    np.testing.assert_array_equal(model["camera_from_world"], camera_from_world(camera))
    np.testing.assert_array_equal(header["worldToCamera"], world_to_camera(camera))
    np.testing.assert_array_equal(header["worldToNDC"], world_to_ndc(camera))
    assert header["chromaticities"] == pytest.approx(exr.REC709_CHROMATICITIES)
    assert header["pixelAspectRatio"] == 1.0
    assert header["screenWindowWidth"] == pytest.approx(2 * np.tan(np.radians(27.5)))
    assert header["screenWindowCenter"].tolist() == [0, 0]
    assert not {"capDate", "owner", "comments"} & set(header)


def test_equal_input_gives_equal_bytes_whatever_the_threads(tmp_path, shot):
    import OpenEXR

    before = OpenEXR.global_thread_count()
    contents = []
    try:
        for i, threads in enumerate((before, 0, 1, 4)):
            OpenEXR.set_global_thread_count(threads)
            contents.append(written(tmp_path / f"{i}.exr", shot, b="2", a="1").read_bytes())
    finally:
        OpenEXR.set_global_thread_count(before)
    assert len(set(contents)) == 1


def test_a_failure_is_an_output_error(tmp_path, shot):
    with raises_error(OutputError, place="a.exr"):
        written(tmp_path / "missing" / "a.exr", shot)


def test_openexr_matrices_agree_with_the_opencv_camera():
    camera = make_camera()
    homogeneous = np.column_stack([POINTS, np.ones(len(POINTS))])
    in_camera = (camera_from_world(camera) @ homogeneous.T).T[:, :3]
    assert in_camera[:, 2].min() > 0
    pixel = in_camera @ projection_of(camera).intrinsics(camera).T
    pixel = pixel[:, :2] / pixel[:, 2:]

    renderman = homogeneous @ world_to_camera(camera).astype(float)  # row vectors; y up, z forward
    np.testing.assert_allclose(renderman[:, :3], in_camera * [1, -1, 1], atol=1e-4)
    assert np.linalg.det(world_to_camera(camera)[:3, :3]) == pytest.approx(-1, abs=1e-5)

    ndc = homogeneous @ world_to_ndc(camera).astype(float)
    np.testing.assert_allclose(ndc[:, :2] / ndc[:, 3:] * [WIDTH, HEIGHT], pixel, atol=1e-3)

    # The screen window, at distance 1: x = ±width/2 at the image's left and right borders.
    x = renderman[:, 0] / renderman[:, 2] / projection_of(camera).screen_window_width(camera)
    np.testing.assert_allclose((x + 0.5) * WIDTH, pixel[:, 0], atol=1e-3)


def test_the_camera_axis_meets_the_image_centre():
    camera = make_camera()
    ahead = np.asarray(camera.position_m) + 10 * camera.world_from_camera[:, 2]
    row = np.array([*ahead, 1.0]) @ world_to_ndc(camera).astype(float)
    np.testing.assert_allclose(row[:2] / row[3], [0.5, 0.5], atol=1e-5)
    row = np.array([*(ahead + np.array([0.0, 0.0, 1.0])), 1.0]) @ world_to_ndc(camera).astype(float)
    assert row[1] / row[3] < 0.5  # up in the world is up in the picture: a smaller y


def bands_shot(names=("B02", "B8A", "B03", "B11")):
    """A shot in bands whose centres are 490, 865, 560, 1610 nm, triangles of 40 nm half width."""
    shot = make_shot([1, 2, 3])
    made = []
    for name, centre in zip(names, (490.0, 865.0, 560.0, 1610.0), strict=True):
        made.append(Band(f"sensor/{name}", Spectrum(centre + np.array([-40.0, 0, 40]), np.array([0.0, 0.7, 0]))))
    rng = np.random.default_rng(4)
    light = rng.random((HEIGHT, WIDTH, len(names))).astype(np.float32)
    radiance = Radiance(light, light * np.float32(0.1), light * np.float32(1.1), 8, tuple(names), tuple(made))
    frame = replace(shot.frame, radiance=radiance)
    return replace(shot, frame=frame, labelled=replace(shot.labelled, frame=frame))


def test_bands_are_channels_of_their_names(tmp_path):
    shot = bands_shot()
    path = written(tmp_path / "a.exr", shot)
    parts, header = read_exr(path), read_exr_attributes(path)
    for part, values in (
        ("radiance", shot.frame.radiance.mean),
        ("radiance.variance", shot.frame.radiance.variance),
        ("radiance.denoised", shot.frame.radiance.denoised),
    ):
        assert set(parts[part]) == {"B02", "B8A", "B03", "B11"}
        for k, name in enumerate(shot.frame.radiance.channels):
            np.testing.assert_array_equal(parts[part][name], values[..., k])
    assert header["forestgen/units.radiance"] == "W m-2 sr-1 nm-1"
    assert header["forestgen/units.radiance.variance"] == "(W m-2 sr-1 nm-1)^2"
    assert "whiteLuminance" not in header
    assert "forestgen/colour_space" not in header
    figures = {row["channel"]: row for row in json.loads(header["forestgen/bands"])}
    assert figures["B8A"] == {
        "channel": "B8A", "response": "sensor/B8A",
        "centre_nm": 865.0, "width_nm": 40.0, "from_nm": 825.0, "to_nm": 905.0,
    }  # fmt: skip


def test_centre_and_width_of_a_lopsided_band():
    """A triangle from 400 over 430 to 500: centroid (400 + 430 + 500) / 3, area by peak 50."""
    fine = np.arange(400.0, 501.0)
    lopsided = Band("x", Spectrum(fine, 3 * np.interp(fine, [400, 430, 500], [0, 1, 0])))
    assert centre_nm(lopsided) == pytest.approx(1330 / 3, abs=0.05)
    assert width_nm(lopsided) == pytest.approx(50.0)


def test_what_the_header_says_of_light(tmp_path, shot):
    import OpenEXR

    radiance = replace(
        shot.frame.radiance, relative_error=0.0123456, relative_error_p95=0.05, stopped_by="target_error"
    )
    frame = replace(shot.frame, radiance=radiance)
    write_exr(tmp_path / "a.exr", replace(shot.labelled, frame=frame), {})
    parts = {part.name(): part.header for part in OpenEXR.File(str(tmp_path / "a.exr"), header_only=True).parts}
    for name, header in parts.items():
        coloured = name in ("radiance", "radiance.denoised")
        assert header.get("whiteLuminance") == (1.0 if coloured else None)
        assert header["forestgen/colour_space"] == "linear Rec. 709 (D65)"
        assert header["forestgen/samples"] == "64"
        assert header["forestgen/relative_error"] == "0.0123456"
        assert header["forestgen/relative_error_p95"] == "0.05"
        assert header["forestgen/stopped_by"] == "target_error"
        assert header["forestgen/biased"].startswith("denoised" if name == "radiance.denoised" else "radiance.denoised")
    units = {name: parts["depth"].get(f"forestgen/units.{name}") for name in parts}
    assert units["radiance"] == units["radiance.denoised"] == "cd/m2, linear Rec. 709 (D65)"
    assert units["radiance.variance"] == "(cd/m2)^2"
    without = {name for name, unit in units.items() if unit is None}
    assert without == {"sun", "boundary", "identity", "coverage"}  # counts, marks and names have none
    write_exr(tmp_path / "b.exr", make_shot([1, 2], denoised=False).labelled, {})
    assert "forestgen/biased" not in read_exr_attributes(tmp_path / "b.exr")
    assert "forestgen/relative_error" not in read_exr_attributes(tmp_path / "b.exr")  # nothing is known of it


def rewritten(path, change):
    """The same file with a part's header or channels changed."""
    import OpenEXR

    parts = OpenEXR.File(str(path), separate_channels=True).parts
    for part in parts:
        change(part.name(), part.header, part.channels)
    OpenEXR.File(list(parts)).write(str(path.with_name("frame.exr")))


def drop(key):
    return lambda name, header, channels: header.pop(key, None)


def put(key, value):
    return lambda name, header, channels: header.__setitem__(key, value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (drop("whiteLuminance"), "whiteLuminance"),
        (put("whiteLuminance", 100.0), "whiteLuminance"),
        (put("chromaticities", (0.7, 0.3, 0.2, 0.7, 0.1, 0.05, 0.31, 0.33)), "chromaticities"),
        (drop("forestgen/units.radiance"), "units.radiance is not"),
        (put("forestgen/units.radiance.variance", "cd/m2"), "units.radiance.variance is not"),
        (drop("forestgen/biased"), "biased"),
        (put("forestgen/bands", '[{"channel": "B02"}]'), "not of radiance's channels"),
    ],
)
def test_the_check_wants_the_header(tmp_path, shot, change, words):
    path = written(tmp_path / "a.exr", shot)
    frame = FrameData(tmp_path, ".")
    rewritten(path, lambda *_: None)
    assert list(light.header.findings(frame)) == []
    rewritten(path, change)
    found = [one.problem for one in light.header.findings(FrameData(tmp_path, "."))]
    assert any(words in problem for problem in found), found


def test_the_check_reads_bands(tmp_path):
    written(tmp_path / "frame.exr", bands_shot())
    assert list(light.header.findings(FrameData(tmp_path, "."))) == []
