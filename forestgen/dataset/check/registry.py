"""All checks, in the order in which they run and findings are named."""

from __future__ import annotations

from forestgen.dataset.check import (
    amodal,
    bop,
    branches,
    cameras,
    coco,
    coverage,
    cryptomatte,
    depth_png,
    geometry,
    keypoints,
    legend,
    light,
    light_files,
    manifest,
    masks,
    motion,
    panoptic,
    plants,
    points,
    yolo,
)
from forestgen.dataset.check.check import DatasetCheck, FrameCheck, always
from forestgen.dataset.check.frame_data import CAMERA, EXR, INSTANCE, PLANTS, SEMANTIC
from forestgen.dataset.check.merged import BOP, COCO, MANIFEST, PANOPTIC, TRANSFORMS

FIRST = FrameCheck("files", "all files are there and readable", "", always, manifest.files)
HASHES = FrameCheck("hashes", "files are those that manifest.json lists", "", always, manifest.frame_hashes)
SHARED_HASHES = DatasetCheck("shared hashes", HASHES.holds, "", always, manifest.shared_hashes)

FRAME_CHECKS = (
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
    FrameCheck("depth.png", "within half a step", depth_png.PICTURE, depth_png.has_depth_png, depth_png.depth_png),
    FrameCheck(
        "cryptomatte",
        "names, plants, shares are frame.exr's",
        cryptomatte.FILE,
        cryptomatte.has_cryptomatte,
        cryptomatte.cryptomatte,
    ),
    FrameCheck("points.ply", "points are the pixels'", points.PLY, points.has_ply, points.ply),
    FrameCheck("points.laz", "points are points.ply's", points.LAZ, points.has_laz, points.laz),
    FrameCheck("coco", "annotations are the mask's plants", COCO, coco.has_share, coco.plants, True),
    FrameCheck("coco stems", "stem masks are the trunks", COCO, coco.has_share, coco.stems, True),
    FrameCheck("coco amodal", "amodal masks hold visible ones", COCO, coco.has_amodal, coco.amodal, True),
    FrameCheck("coco keypoints", "keypoints are plants.parquet's", COCO, coco.has_points, coco.points, True),
    FrameCheck("coco measures", "numbers are plants.parquet's", COCO, coco.has_share, coco.measures, True),
    FrameCheck("coco shard", "annotations.json is coco.json's share", coco.SHARD, coco.has_shard, coco.shard),
    FrameCheck("panoptic", "segments cover the image", PANOPTIC, panoptic.has_share, panoptic.segments, True),
    FrameCheck("panoptic.png", "it is panoptic/'s", "panoptic.png", panoptic.has_own_picture, panoptic.own_picture),
    FrameCheck("yolo boxes", "boxes are the masks'", "yolo", yolo.has_boxes, yolo.boxes, True),
    FrameCheck("yolo outlines", "rings fill to the masks", "yolo", yolo.has_outlines, yolo.outlines, True),
    FrameCheck("transforms", "cameras are camera.json's", TRANSFORMS, cameras.has_share, cameras.transforms, True),
    FrameCheck("bop", "counts and masks are the plants'", BOP, bop.has_share, bop.plants, True),
)

DATASET_CHECKS = (
    DatasetCheck("manifest", "lists the frames and their files", MANIFEST, always, manifest.listing),
    DatasetCheck("classes.json", "names follow from the recipe", legend.FILE, legend.has_legend, legend.legend),
    DatasetCheck("coco files", "images, ids, categories, licences", COCO, coco.has_coco, coco.structure),
    DatasetCheck("panoptic files", "images and ids", PANOPTIC, panoptic.has_panoptic, panoptic.structure),
    DatasetCheck("yolo files", "images, labels, names of classes", "yolo", yolo.has_yolo, yolo.structure),
    DatasetCheck("transforms files", "each frame once", TRANSFORMS, cameras.has_transforms, cameras.structure),
    DatasetCheck("bop files", "each frame in a scene", BOP, bop.has_bop, bop.structure),
)
