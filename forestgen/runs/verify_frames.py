"""Each frame's files against its row of the index, and whether splits share a seed or a plant community."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.core.errors import DatasetError
from forestgen.core.progress import Progress
from forestgen.dataset.check.files import read_json, read_picture, read_table, read_text
from forestgen.dataset.check.finding import MISUNDERSTOOD, Finding, UnreadableError, misunderstood
from forestgen.dataset.index import COLUMNS, INDEX_NAME, open_index, read_index
from forestgen.dataset.settings import DRAW
from forestgen.recipe.map_files import recipe_hash
from forestgen.runs.parallel import in_order
from forestgen.runs.verify_manifests import plain_yaml

Check = tuple[str, str, int, list[Finding]]  # name, what holds, how many it looked at, findings
_HINT = "give the recipe one split, or let it draw each image's plants"


@dataclass(frozen=True)
class FrameFacts:
    """What a frame's files say."""

    row: Mapping[str, Any]  # the index' own
    community: bytes  # hash of the plants' species and places; empty: bare ground
    findings: tuple[Finding, ...]


def check_frames(root: Path, said: Mapping[str, Any], jobs: int | None, progress: Progress) -> list[Check]:
    """The checks that open every frame.

    Parameters
    ----------
    said : dataset.json.
    jobs : threads; by default the cores.
    """
    class_names = said["settings"]["class_names"]
    frames: list[Finding] = []
    seeds, communities = _Shared("seed"), _Shared("plant community")
    with ThreadPoolExecutor(jobs) as pool, progress.stage("frames", int(said["frames"])) as advance:
        for facts in in_order(pool, partial(_facts, root, class_names), _rows(root)):
            advance(1)
            frames += facts.findings
            seeds.add(str(facts.row.get("image_seed")).encode(), facts.row)
            communities.add(facts.community, facts.row)
    images = int(said["images"])
    return [
        ("frames", "the index tells of frames what their files show", int(said["frames"]), frames),
        ("seeds", "no image's seed is in two splits", images, seeds.findings),
        ("communities", "no plant community is in two splits", images, communities.findings),
    ]


def column_findings(root: Path, said: Mapping[str, Any]) -> Iterator[Finding]:
    """Columns of the index that no data set of these recipes has.

    Parameters
    ----------
    said : dataset.json.
    """
    known = {*COLUMNS, *(DRAW + key for recipe in said["recipes"] for key in recipe["draws"])}
    with open_index(root / INDEX_NAME, ()) as file:
        names = file.schema_arrow.names
    for name in names:
        if name not in known:
            yield Finding(INDEX_NAME, "unknown column of the index", "those that forestgen writes", f"{name!r:.80}")


def _rows(root: Path) -> Iterator[dict[str, Any]]:
    """Rows of the index, as far as it can be read: its own check says where it ends."""
    try:
        yield from read_index(root / INDEX_NAME)
    except DatasetError:
        return


class _Shared:
    """What only one split may have."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._first: dict[bytes, tuple[str, str]] = {}  # what -> split and frame that had it first
        self.findings: list[Finding] = []

    def add(self, mark: bytes, row: Mapping[str, Any]) -> None:
        if not mark:
            return
        split, frame = self._first.setdefault(mark, (row["split"], row["folder"]))
        if split != row["split"]:
            problem = f"two splits share a {self._what}"
            expected = f"another than that of {frame} ({_HINT})"
            self.findings.append(Finding(str(row["folder"]), problem, expected, f"the same in {row['split']}"))


def _facts(root: Path, class_names: Sequence[str], row: Mapping[str, Any]) -> FrameFacts:
    """Compare each file of a frame with the row; one that cannot be read leaves the others."""
    folder = str(row["folder"])
    findings: list[Finding] = []

    def compared(read: Callable[[], Mapping[str, Any]]) -> None:
        try:
            shown = read()
            findings.extend(_wrong(row, key, value) for key, value in shown.items() if row[key] != value)
        except UnreadableError as error:
            findings.append(error.finding)
        except MISUNDERSTOOD as error:
            findings.append(misunderstood(folder, error, str(row["frame"])))

    def plants() -> dict[str, Any]:
        table = read_table(root, f"{folder}/plants.parquet")
        community.append(_community(table))
        return _plants_shown(table)

    def classes() -> dict[str, Any]:
        semantic = read_picture(root, f"{folder}/semantic.png")
        height, width = semantic.shape
        return {"class_pixels": _counts(semantic, class_names), "height_px": height, "width_px": width}

    def camera() -> dict[str, Any]:
        content = read_json(root, f"{folder}/camera.json")
        place = zip(("camera_x_m", "camera_y_m", "camera_z_m"), content["position_m"], strict=True)
        return {"camera": content.get("name"), **dict(place)}

    def recipe() -> dict[str, Any]:
        file = f"{folder}/recipe.yaml"
        try:
            return {"recipe_hash": _hash_of(read_text(root, file))}
        except UnreadableError as error:
            raise UnreadableError(replace(error.finding, file=file)) from error

    community: list[bytes] = []
    for read in (plants, classes, camera, recipe):
        compared(read)
    return FrameFacts(row, community[0] if community else b"", tuple(findings))


@lru_cache(maxsize=64)
def _hash_of(text: str) -> str:
    """Hash of a drawn recipe, which all frames of an image share."""
    return recipe_hash(plain_yaml(text, ""))


def _wrong(row: Mapping[str, Any], key: str, value: Any) -> Finding:
    problem = f"{key} of {row['folder']} is not what its files show"
    return Finding(INDEX_NAME, problem, f"{value!r:.120}", f"{row[key]!r:.120}", image=str(row["frame"]))


def _plants_shown(plants: Mapping[str, Any]) -> dict[str, Any]:
    pixels = plants["visible_pixels"]
    seen = pixels > 0
    species = plants["species"][seen]
    names = sorted(set(species))
    return {
        "plants": len(pixels),
        "plants_in_view": int(seen.sum()),
        "plants_truncated": int(plants["truncated"][seen].sum()),
        "species_instances": {name: int((species == name).sum()) for name in names},
        "species_pixels": {name: int(pixels[seen][species == name].sum()) for name in names},
    }


def _counts(semantic: Any, class_names: Sequence[str]) -> dict[str, int]:
    counts = np.bincount(semantic.ravel(), minlength=len(class_names))
    return {class_names[number]: int(counts[number]) for number in np.flatnonzero(counts).tolist()}


def _community(plants: Mapping[str, Any]) -> bytes:
    """Hash of species and places."""
    if not len(plants["species"]):
        return b""
    digest = hashlib.sha256("\n".join(plants["species"].tolist()).encode())
    for axis in ("x_m", "y_m"):
        digest.update(np.ascontiguousarray(plants[axis], dtype=np.float64).tobytes())
    return digest.digest()[:16]
