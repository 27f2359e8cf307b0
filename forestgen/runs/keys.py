"""The identity of a job: a hash of all that its files depend on."""

from __future__ import annotations

import hashlib

from forestgen.core.cache import code_hash
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.map_files import recipe_hash

# Everything that shapes a frame's files; the layers above only call it.
_SOURCES = (
    "architecture", "atmosphere", "community", "core", "dataset", "geometry", "labels", "lsystem", "plants", "recipe",
    "render", "scene", "__init__.py", "pipeline.py",
)  # fmt: skip
# Of these, what only reads frames, writes the files over all of them, or checks and shows what people give and see.
_WITHOUT = (
    "community/fitting/report.py", "community/point_statistics.py", "community/summary.py",
    "dataset/card.py", "dataset/check", "dataset/exr_chunks.py",
    "dataset/frame.py", "dataset/index.py", "dataset/pack", "dataset/report",
)  # fmt: skip
_COMPUTE_WITH = (
    "numpy", "scipy", "numba", "pvlib", "mitsuba", "drjit", "mitsuba-oidn", "colour-science", "trimesh",
    "OpenEXR", "pillow", "pyarrow", "pycocotools", "laspy", "mmh3",
)  # fmt: skip


def job_key(drawn: DrawnRecipe, versions: str) -> str:
    """The image's number, then a hash, hexadecimal, of all that its files depend on.

    That is the drawn recipe, its seed, its split, and the versions that matter (`versions_hash`). The number is there
    for order: names of records sort by image, and tell which images are done before any is opened.
    """
    text = repr((versions, recipe_hash(drawn.data), drawn.image_seed, drawn.split))
    return f"{drawn.image_index:06d}-{hashlib.sha256(text.encode()).hexdigest()[:40]}"


def image_of_key(key: str) -> int:
    """Number of a key's image; -1 if it is no key."""
    number, _, rest = key.partition("-")
    return int(number) if number.isascii() and number.isdecimal() and len(rest) == 40 else -1


def versions_hash() -> str:
    """Hash of forestgen's code and tables, of the packages that it computes with, and of the kind of machine."""
    # Species and programs are not among the tables: a drawn recipe holds them.
    tables = tuple(scenes_dir() / kind for kind in ("climate", "modules", "spectra"))
    return code_hash(_SOURCES, _COMPUTE_WITH, tables, _WITHOUT)
