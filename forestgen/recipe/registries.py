"""Data set formats and packs by name: the recipe's schema needs the formats' names, not their code."""

from __future__ import annotations

from forestgen.core.registry import Registry

DEFAULT_FORMATS = ("coco",)

# In the order in which their checks run.
DATASET_FORMATS = Registry(
    "dataset_format",
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
    contract="forestgen.dataset.formats.format:DatasetFormat",
)

PACKS = Registry(
    "pack",
    {
        "webdataset": ("forestgen.dataset.pack.webdataset:PACK", "tar files, in which files of one stem are a frame"),
        "huggingface": ("forestgen.dataset.pack.huggingface:PACK", "Parquet files for datasets.load_dataset"),
    },
    contract="forestgen.dataset.pack.pack:Pack",
)
