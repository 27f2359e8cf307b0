"""A data set to pack: frames of drawn masks, written by the real writers and laid out as a batch leaves them."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from PIL import Image

from forestgen.dataset.writer import write_dataset, write_frame
from forestgen.runs.description import SCHEMA, this_version
from support.data_sets import write_rows

sys.path.append(str(Path(__file__).parents[1] / "unit" / "dataset"))
from dataset_shots import HEIGHT, SETTINGS, WIDTH, make_shot

SPLITS = {"train": (0, 2, 3, 5, 6), "val": (1, 4)}  # numbers of the images
CLASSES = ("nothing", "ground", "poplar", "spruce", "oak")
PIXELS = WIDTH * HEIGHT
CARD = "---\nlicense: cc-by-4.0\n---\n\n# Weeds\n\nThree species.\n"
_SETTINGS = replace(SETTINGS, formats=("coco", "depth_png"))


def batch(root: Path) -> Path:
    """Seven frames in two splits."""
    rows = []
    for split, images in SPLITS.items():
        folders = [_frame(root / split, image) for image in images]
        write_dataset(root / split, folders, _SETTINGS)
        rows += [_row(split, folder, image) for folder, image in zip(folders, images, strict=True)]
    write_rows(root / "index.parquet", sorted(rows, key=lambda row: row["image"]))
    _describe(root, SPLITS)
    (root / "README.md").write_text(CARD, encoding="utf-8")
    return root


def many(root: Path, frame: Path, copies: int) -> Path:
    """Many names for one frame, as a split of a data set."""
    split, rows = root / "train", []
    for number in range(copies):
        folder = split / f"{number:06d}-camera0"
        folder.mkdir(parents=True)
        for file in frame.iterdir():
            os.link(file, folder / file.name)
        known = {"width_px": WIDTH, "height_px": HEIGHT, "channels": ["R", "G", "B"], "plants_in_view": 5}
        rows.append({"frame": folder.name, "split": "train", "image": number, "camera": "camera0", **known})
    shutil.copy(frame.parent / "classes.json", split)
    write_rows(root / "index.parquet", rows)
    _describe(root, {"train": tuple(range(copies))})
    return root


def _describe(root: Path, splits: Mapping[str, tuple[int, ...]]) -> None:
    """dataset.json, with what packs need of it."""
    counts = {split: {"images": len(images), "frames": len(images)} for split, images in splits.items()}
    images = sum(len(images) for images in splits.values())
    recipe = {"file": "recipe.yaml", "hash": "", "root_seed": 7, "asked": [], "splits": dict.fromkeys(splits, 1.0)}
    content = {
        "schema": SCHEMA,
        "recipes": [{**recipe, "draws": {}}],
        "images": images,
        "frames": images,
        "splits": counts,
        "image_seeds_sha256": "",
        "settings": asdict(_SETTINGS),
        "made_with": [this_version()],
        "files": {},
    }
    (root / "dataset.json").write_text(json.dumps(content), encoding="utf-8")


def _frame(split: Path, image: int) -> Path:
    folder = split / f"{image:06d}-camera0"
    shot = make_shot([*range(1, 5 + image), 70_000 + image, 999_999], seed=image)
    write_frame(folder, shot.labelled, f"seed: {image}\n", {"seed": "7"}, _SETTINGS)
    return folder


def _row(split: str, folder: Path, image: int) -> dict:
    counts = Counter(np.asarray(Image.open(folder / "semantic.png")).ravel().tolist())
    return {
        "frame": folder.name,
        "folder": f"{split}/{folder.name}",
        "split": split,
        "image": image,
        "camera": "camera0",
        "width_px": WIDTH,
        "height_px": HEIGHT,
        "channels": ["R", "G", "B"],
        "plants_in_view": 4 + image,
        "sun_elevation_deg": 30.0 + image,
        "instance_pixels_histogram": [image, 2],
        "class_pixels": {CLASSES[number]: pixels for number, pixels in counts.items()},
        "notes": ["a note"] * (image % 2),
        "draw.sky.turbidity": 2.5,
    }


def frames(root: Path, split: str) -> dict[str, Path]:
    """Name -> folder, of a split."""
    return {path.name: path for path in sorted((root / split).iterdir()) if path.is_dir()}


def annotations(folder: Path) -> list[dict]:
    return json.loads((folder / "annotations.json").read_bytes())["annotations"]
