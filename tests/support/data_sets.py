"""Data sets with all that a report is made from, without a render: random masks, and an index that counts them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image

from forestgen.dataset import png
from forestgen.dataset.index import INDEX_NAME, DrawTypes, write_index
from forestgen.dataset.settings import DatasetSettings
from forestgen.recipe.dataset import split_of

SPLITS = {"train": 8.0, "val": 1.0, "test": 1.0}
SIZE_PX = (48, 36)
STAGES = {"community": 2.1, "plants": 1.4, "radiance": 9.0, "identity": 1.1, "labels": 0.6, "write": 0.4}


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write an index of rows that are all in memory."""
    types = DrawTypes()
    for row in rows:
        types.add(row)
    write_index(path, rows, types.columns)


def read_instance(path: Path) -> NDArray[np.uint32]:
    """(H, W) plant ids of an instance PNG."""
    with Image.open(path) as picture:
        return np.asarray(picture).astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)


def write_data_set(
    folder: Path,
    images: int,
    *,
    seed: int = 0,
    species: Sequence[str] = ("fireweed", "poplar", "spruce"),
    description: str = "Forest edges",
    message: str = "the camera stands in a trunk",
    pictures: bool = True,
    run: bool = True,
) -> list[dict[str, Any]]:
    """Write a data set's folder of one camera; its index's rows.

    Parameters
    ----------
    images : how many; the last one failed and is missing, if there is a `run`.
    message : of its failure.
    pictures : whether frames have their PNGs.
    run : whether there is a run/ folder.
    """
    rng = np.random.default_rng(seed)
    settings = DatasetSettings(
        tuple(species), ("nothing", "ground", *species), tuple(species), tuple(range(len(species)))
    )
    rows = [_frame(folder, rng, image, settings, pictures=pictures) for image in range(images)]
    if run and rows:
        rows.pop()
        _write_run(folder, rng, images, message)
    folder.mkdir(parents=True, exist_ok=True)
    for split in {row["split"] for row in rows}:
        (folder / split).mkdir(exist_ok=True)
        png.write_legend(folder / split, settings)
    write_rows(folder / INDEX_NAME, rows)
    (folder / "dataset.json").write_text(json.dumps(_card(images, rows, description)), encoding="utf-8")
    return rows


def _frame(
    folder: Path, rng: np.random.Generator, image: int, settings: DatasetSettings, *, pictures: bool
) -> dict[str, Any]:
    plants, species = _masks(rng, len(settings.species_names))
    semantic = np.where(plants > 0, species + 2, plants < 0).astype(np.uint8)
    instance = np.maximum(plants, 0).astype(np.uint32)
    row = _row(rng, image, settings, instance, semantic)
    if pictures:
        target = folder / str(row["folder"])
        target.mkdir(parents=True)
        colours = png.class_palette(len(settings.class_names)).astype(float)[semantic]
        picture = np.clip(0.7 * colours + rng.normal(20, 14, colours.shape), 0, 255).astype(np.uint8)
        png.write_png(target / "preview.png", picture)
        png.write_png(target / "overlay.png", png.overlay(picture, instance))
        png.write_semantic(target / "semantic.png", semantic, settings.class_names)
        png.write_instance(target / "instance.png", instance)
    return row


def _masks(rng: np.random.Generator, kinds: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Instances (0 sky, -1 ground) of round plants, and the species of each pixel's plant."""
    width, height = SIZE_PX
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    instance = np.where(y > height * 0.6, -1, 0).astype(np.int64)
    species = np.zeros_like(instance)
    chances = 0.3 ** np.arange(kinds)
    for plant in range(1, int(rng.integers(1, 12))):
        radius = rng.uniform(0.5, 8)
        inside = np.hypot(x - rng.uniform(0, width), y - rng.uniform(0.3 * height, height)) < radius
        instance[inside], species[inside] = plant, rng.choice(kinds, p=chances / chances.sum())
    return instance, species


def _row(
    rng: np.random.Generator,
    image: int,
    settings: DatasetSettings,
    instance: NDArray[np.uint32],
    semantic: NDArray[np.uint8],
) -> dict[str, Any]:
    ids, first, pixels = np.unique(instance, return_index=True, return_counts=True)
    seen, names = ids > 0, settings.species_names
    kind = semantic.ravel()[first[seen]].astype(int) - 2
    won = pixels[seen]
    by_species = {names[k]: int((kind == k).sum()) for k in np.unique(kind)}
    split, name = split_of(SPLITS, image), f"{image:06d}-eye"
    elevation, azimuth, turbidity = float(rng.uniform(15, 60)), float(rng.uniform(0, 360)), float(rng.uniform(2, 6))
    clouds, near = str(rng.choice(["noise", "none", "cumulus"])), float(rng.uniform(0.8, 6))
    return {
        "frame": name,
        "folder": f"{split}/{name}",
        "split": split,
        "image": image,
        "camera": "eye",
        "width_px": SIZE_PX[0],
        "height_px": SIZE_PX[1],
        "camera_kind": "perspective",
        "hfov_deg": float(rng.uniform(45, 75)),
        "camera_height_m": float(rng.uniform(1.5, 2.0)),
        "camera_pitch_deg": float(rng.normal(2, 3)),
        "camera_azimuth_deg": float(rng.uniform(0, 360)),
        "sky_kind": "clear",
        "clouds": clouds,
        "cloud_cover": float(rng.uniform(0.1, 0.6)) if clouds == "noise" else None,
        "sun_elevation_deg": elevation,
        "sun_azimuth_deg": azimuth,
        "turbidity": turbidity,
        "season": str(rng.choice(["summer", "autumn"])),
        "sky_share": float((semantic == 0).mean()),
        "sunlit_share": float(rng.beta(2, 3)),
        "depth_min_m": near,
        "depth_median_m": near * float(rng.lognormal(2, 0.4)),
        "depth_max_m": near * float(rng.lognormal(4.4, 0.5)),
        "plants": int(rng.integers(50, 900)),
        "plants_in_view": len(won),
        "visible_fraction_median": float(rng.beta(3, 2)),
        "instance_pixels_median": float(np.median(won)) if len(won) else None,
        "instance_pixels_histogram": np.bincount(np.frexp(won.astype(float))[1] - 1).tolist() if len(won) else [],
        "class_pixels": {settings.class_names[k]: int((semantic == k).sum()) for k in np.unique(semantic)},
        "category_instances": by_species,
        "species_instances": by_species,
        "species_pixels": {names[k]: int(won[kind == k].sum()) for k in np.unique(kind)},
        "notes": [],
        "draw.sky.sun.elevation_deg": elevation,
        "draw.sky.sun.azimuth_deg": azimuth,
        "draw.sky.turbidity": turbidity,
        "draw.sky.clouds.type": clouds,
        "draw.community.steps": int(30 + 80 * turbidity + rng.integers(0, 60)),
    }


def _card(images: int, rows: Sequence[dict[str, Any]], description: str) -> dict[str, Any]:
    there = {row["image"] for row in rows}
    draws = {
        "sky.sun.elevation_deg": {"uniform": [15, 60]},
        "sky.sun.azimuth_deg": {"uniform": [0, 360]},
        "sky.turbidity": {"uniform": [2, 6]},
        "sky.clouds.type": {"choice": ["noise", "none", "cumulus"]},
        "community.steps": {"integers": [30, 600]},
    }
    recipe = {
        "file": "recipe.yaml",
        "hash": "5f3a" * 16,
        "root_seed": 1,
        "images": images,
        "missing": [[image, image] for image in range(images) if image not in there],
        "draws": draws,
    }
    return {
        "schema": "forestgen-dataset/1",
        "description": description,
        "contributor": "",
        "licence": {"name": "CC BY 4.0", "url": "https://creativecommons.org/licenses/by/4.0/"},
        "recipes": [recipe],
        "splits": {split: {} for split in SPLITS},
        "made_with": [{"python": "3.11.9", "platform": {"system": "Linux", "machine": "x86_64"},
                       "packages": {"forestgen": "0.1.0", "mitsuba": "3.9.1"}}],
        "files": {"SPLIT/FRAME": {"files": 12 * len(rows), "bytes": 1_200_000 * len(rows)}},
    }  # fmt: skip


def _write_run(folder: Path, rng: np.random.Generator, images: int, message: str) -> None:
    """A log of two workers whose last image fails three times, and the jobs' table."""
    clock = datetime(2026, 1, 5, 20, tzinfo=UTC)
    lines: list[str] = []
    jobs: list[dict[str, Any]] = []

    def add(event: str, **fields: Any) -> None:
        lines.append(json.dumps({"time": clock.isoformat(timespec="milliseconds"), "event": event, **fields}))

    add("start", total=images)
    for image in range(images - 1):
        timings = {stage: float(mean * rng.lognormal(0, 0.3)) for stage, mean in STAGES.items()}
        seconds = sum(timings.values())
        clock += timedelta(seconds=seconds / 2)
        memory = int(rng.normal(900, 40) * 2**20)
        job = {"image": image, "split": split_of(SPLITS, image), "attempt": 1, "seconds": seconds, "timings_s": timings,
               "peak_memory_bytes": memory, "worker": f"host:{4000 + image % 2}", "frames": 1}  # fmt: skip
        add("job_done", **job)
        jobs.append(job)
    for attempt in (1, 2, 3):
        clock += timedelta(seconds=4)
        last = images - 1
        add("job_failed", image=last, split=split_of(SPLITS, last), attempt=attempt, kind="worker", message=message,
            will_retry=attempt < 3)  # fmt: skip
    add("worker_lost")
    lines.append('{"time": "2026-01-05T2')  # what a kill leaves
    add("finish")
    (folder / "run").mkdir(parents=True)
    (folder / "run" / "log.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    if jobs:
        columns = {name: [job[name] for job in jobs] for name in jobs[0] if name != "timings_s"}
        timed = pa.array([list(job["timings_s"].items()) for job in jobs], pa.map_(pa.string(), pa.float64()))
        pq.write_table(pa.table({**columns, "timings_s": timed}), folder / "run" / "jobs.parquet")
