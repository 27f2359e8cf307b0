"""All checks, in the order in which they run and findings are named."""

from __future__ import annotations

from collections.abc import Iterator

from forestgen.dataset.check import (
    amodal,
    branches,
    coverage,
    geometry,
    keypoints,
    legend,
    light,
    light_files,
    manifest,
    masks,
    motion,
    plants,
)
from forestgen.dataset.check.check import DatasetCheck, FrameCheck, always
from forestgen.dataset.check.frame_data import CAMERA, EXR, INSTANCE, PLANTS, SEMANTIC
from forestgen.dataset.check.merged import MANIFEST
from forestgen.dataset.formats.format import known_formats

FIRST = FrameCheck("files", "all files are there and readable", "", always, manifest.files)
HASHES = FrameCheck("hashes", "files are those that manifest.json lists", "", always, manifest.frame_hashes)
SHARED_HASHES = DatasetCheck("shared hashes", HASHES.holds, "", always, manifest.shared_hashes)

_FRAME_CHECKS = (
    FrameCheck("camera", "one camera in all files", CAMERA, always, geometry.camera),
    FrameCheck("ids", "plants of the image are in the table", PLANTS, always, masks.ids),
    FrameCheck("instance", "instance.png is frame.exr's mask", INSTANCE, masks.holds_png, masks.instance_png),
    FrameCheck("part", "parts suit their plants", EXR, always, masks.parts),
    FrameCheck("semantic", "classes follow from species and part", SEMANTIC, always, masks.semantic),
    FrameCheck("names", "numbers have the recipe's names", SEMANTIC, legend.has_names, legend.names),
    FrameCheck("coverage", "shares fall and sum to 1", EXR, coverage.has_coverage, coverage.coverage),
    FrameCheck("plants", "pixels and boxes are the mask's", PLANTS, always, plants.visible),
    FrameCheck("areas", "visible areas are sums of coverage", PLANTS, coverage.has_coverage, plants.areas),
    FrameCheck("stems", "stem pixels are the mask's", PLANTS, plants.has_stems, plants.stems),
    FrameCheck("measures", "sizes and places are numbers", PLANTS, always, plants.finite),
    FrameCheck("keypoints", "on the plant, hidden or outside", PLANTS, keypoints.has_keypoints, keypoints.keypoints),
    FrameCheck("stem places", "stem bases are projected places", PLANTS, keypoints.has_places, keypoints.places),
    FrameCheck("amodal", "the visible lies within the amodal", PLANTS, amodal.has_amodal, amodal.amodal),
    FrameCheck("depth", "positive; distance no shorter", EXR, geometry.has_depth, geometry.depth),
    FrameCheck("sky", "no depth, position, normal, part", EXR, geometry.has_depth, geometry.sky),
    FrameCheck("circle", "nothing outside of a fisheye's", EXR, geometry.has_circle, geometry.circle),
    FrameCheck("position", "depth reprojects to the position", EXR, geometry.has_position, geometry.position),
    FrameCheck("normals", "unit, towards the camera", EXR, geometry.has_normals, geometry.normals),
    FrameCheck("centre", "the centre ray's plant is in the table", EXR, geometry.has_centre, geometry.centre),
    FrameCheck("modules", "plants have branch modules, or none", EXR, branches.has_branches, branches.branches),
    FrameCheck("radiance", "finite, not negative", EXR, light.has_radiance, light.radiance),
    FrameCheck("light units", "units, white, bands, bias are told", EXR, light_files.has_radiance, light_files.header),
    FrameCheck("raw", "numbers are the radiance's and noise", light_files.RAW, light_files.has_raw, light_files.raw),
    FrameCheck("light", "sun, albedo, clouds within bounds", EXR, light.has_light, light.surfaces),
    FrameCheck("motion", "vectors land on the same plant", EXR, motion.has_motion, motion.motion),
)

_DATASET_CHECKS = (
    DatasetCheck("manifest", "lists the frames and their files", MANIFEST, always, manifest.listing),
    DatasetCheck("classes.json", "names follow from the recipe", legend.FILE, legend.has_legend, legend.legend),
)


def frame_checks() -> Iterator[FrameCheck]:
    """Those of a frame's own labels, then those of each registered format."""
    yield from _FRAME_CHECKS
    for one in known_formats():
        yield from one.frame_checks()


def dataset_checks() -> Iterator[DatasetCheck]:
    """Those of the manifest and the classes, then those of each registered format."""
    yield from _DATASET_CHECKS
    for one in known_formats():
        yield from one.dataset_checks()
