"""Data set formats and cameras' projections, by their names in recipes, whose schema needs no more of most of them."""

from __future__ import annotations

from forestgen.core.registry import Registry

DEFAULT_FORMATS = ("coco",)
DEFAULT_PROJECTION = "perspective"

# In the order in which their checks run.
DATASET_FORMATS = Registry(
    "data set format",
    {
        "depth_png": ("forestgen.dataset.formats.depth_png:FORMAT", "16-bit depth along the camera's axis"),
        "cryptomatte": ("forestgen.dataset.formats.cryptomatte:FORMAT", "coverage by name, for compositing programs"),
        "points": ("forestgen.dataset.formats.points:FORMAT", "the surfaces that pixels see as PLY and LAZ"),
        "coco": ("forestgen.dataset.formats.coco:FORMAT", "COCO instances with amodal masks and keypoints"),
        "panoptic": ("forestgen.dataset.formats.panoptic:FORMAT", "COCO panoptic: plants, ground and sky"),
        "yolo": ("forestgen.dataset.formats.yolo:FORMAT", "outlines and boxes for YOLO trainers"),
        "nerfstudio": ("forestgen.dataset.formats.nerfstudio:FORMAT", "cameras for radiance fields and splats"),
        "bop": ("forestgen.dataset.formats.bop:FORMAT", "poses, visible fractions and masks of each plant"),
    },
)

PROJECTIONS = Registry(
    "projection",
    {
        "perspective": ("forestgen.scene.projections.perspective:PROJECTION", "a pinhole, or a thin lens that blurs"),
        "fisheye": ("forestgen.scene.projections.fisheye:PROJECTION", "equidistant, up to all around"),
        "orthographic": ("forestgen.scene.projections.orthographic:PROJECTION", "parallel rays, as of a map"),
        "panorama": ("forestgen.scene.projections.panorama:PROJECTION", "equirectangular, all around, level"),
    },
)
