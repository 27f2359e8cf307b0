"""Each frame's files against its row of the index, and against an image rendered again; what splits share."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import DatasetError, ForestgenError
from forestgen.core.progress import Progress, Timings
from forestgen.dataset.check import files
from forestgen.dataset.index import INDEX_NAME, read_index
from forestgen.dataset.png import thumbnail_name, write_thumbnail
from forestgen.dataset.safe_path import SafePath, one_line
from forestgen.recipe.map_files import recipe_hash
from forestgen.runs.description import this_version
from forestgen.runs.records import in_order
from forestgen.runs.storage import files_below
from forestgen.runs.verify_index import plain_yaml

Check = tuple[str, str, int, list[files.Finding]]  # name, what holds, how many it looked at, findings
_HINT = "give the recipe one split, or let it draw each image's plants"


@dataclass(frozen=True)
class FrameFacts:
    """What a frame's files say."""

    row: Mapping[str, Any]  # the index' own
    community: bytes  # hash of the plants' species and places; empty: bare ground
    findings: tuple[files.Finding, ...]


def check_frames(root: Path, description: Mapping[str, Any], jobs: int | None, progress: Progress) -> list[Check]:
    """The checks that open every frame.

    `description`: dataset.json.
    `jobs`: threads; by default the cores.
    """
    class_names = description["settings"]["class_names"]
    frames: list[files.Finding] = []
    first: dict[tuple[str, bytes], tuple[str, str]] = {}  # what and its mark -> split and frame that had it first
    seeds: list[files.Finding] = []
    communities: list[files.Finding] = []
    with ThreadPoolExecutor(jobs) as pool, progress.stage("frames", int(description["frames"])) as advance:
        for facts in in_order(pool, partial(_facts, root, class_names), _rows(root)):
            advance(1)
            frames += facts.findings
            seeds += _shared(first, "seed", str(facts.row.get("image_seed")).encode(), facts.row)
            communities += _shared(first, "plant community", facts.community, facts.row)
    images = int(description["images"])
    return [
        ("frames", "the index tells of frames what their files show", int(description["frames"]), frames),
        ("seeds", "no image's seed is in two splits", images, seeds),
        ("communities", "no plant community is in two splits", images, communities),
    ]


def _rows(root: Path) -> Iterator[dict[str, Any]]:
    """Rows of the index, as far as it can be read: its own check says where it ends."""
    try:
        yield from read_index(root / INDEX_NAME)
    except DatasetError:
        return


def _shared(
    first: dict[tuple[str, bytes], tuple[str, str]], what: str, mark: bytes, row: Mapping[str, Any]
) -> Iterator[files.Finding]:
    """A finding if another split has had what only one may have."""
    split, frame = first.setdefault((what, mark), (row["split"], row["folder"]))
    if mark and split != row["split"]:
        expected = f"another than that of {frame} ({_HINT})"
        problem = f"two splits share a {what}"
        yield files.Finding(str(row["folder"]), problem, expected, f"the same in {row['split']}")


def _facts(root: Path, class_names: Sequence[str], row: Mapping[str, Any]) -> FrameFacts:
    """Compare each file of a frame with the row; one that cannot be read leaves the others."""
    folder = str(row["folder"])
    findings: list[files.Finding] = []

    def plants() -> dict[str, Any]:
        table = files.read_table(root, f"{folder}/plants.parquet")
        community.append(_community(table))
        return _plants_shown(table)

    def classes() -> dict[str, Any]:
        semantic = files.read_picture(root, f"{folder}/semantic.png")
        height, width = semantic.shape
        counts = np.bincount(semantic.ravel(), minlength=len(class_names))
        pixels = {class_names[number]: int(counts[number]) for number in np.flatnonzero(counts).tolist()}
        return {"class_pixels": pixels, "height_px": height, "width_px": width}

    def camera() -> dict[str, Any]:
        content = files.read_json(root, f"{folder}/camera.json")
        position = zip(("camera_x_m", "camera_y_m", "camera_z_m"), content["position_m"], strict=True)
        return {"camera": content.get("name"), **dict(position)}

    def recipe() -> dict[str, Any]:
        file = f"{folder}/recipe.yaml"
        try:
            return {"recipe_hash": _hash_of(files.read_text(root, file))}
        except files.UnreadableError as error:
            raise files.UnreadableError(replace(error.finding, file=file)) from error

    community: list[bytes] = []
    for read in (plants, classes, camera, recipe):
        try:
            findings.extend(_wrong(row, key, value) for key, value in read().items() if row[key] != value)
        except files.UnreadableError as error:
            findings.append(error.finding)
        except files.MISUNDERSTOOD as error:
            findings.append(files.misunderstood(folder, error, str(row["frame"])))
    return FrameFacts(row, community[0] if community else b"", tuple(findings))


@lru_cache(maxsize=64)  # all frames of an image share a drawn recipe
def _hash_of(text: str) -> str:
    return recipe_hash(plain_yaml(text, ""))


def _wrong(row: Mapping[str, Any], key: str, value: Any) -> files.Finding:
    problem = f"{key} of {row['folder']} is not what its files show"
    return files.Finding(INDEX_NAME, problem, f"{value!r:.120}", f"{row[key]!r:.120}", image=str(row["frame"]))


def _plants_shown(plants: Mapping[str, Any]) -> dict[str, Any]:
    pixels = plants["visible_pixels"]
    seen = pixels > 0
    species = plants["species"][seen]
    names = sorted(set(species))
    return {
        "plants": int(_on_site(plants).sum()),
        "plants_in_view": int(seen.sum()),
        "plants_truncated": int(plants["truncated"][seen].sum()),
        "species_instances": {name: int((species == name).sum()) for name in names},
        "species_pixels": {name: int(pixels[seen][species == name].sum()) for name in names},
    }


def _community(plants: Mapping[str, Any]) -> bytes:
    """Hash of species and places of the site's plants."""
    rows = _on_site(plants)
    if not rows.any():
        return b""
    digest = hashlib.sha256("\n".join(plants["species"][rows].tolist()).encode())
    for axis in ("x_m", "y_m"):
        digest.update(np.ascontiguousarray(plants[axis][rows], dtype=np.float64).tobytes())
    return digest.digest()[:16]


def _on_site(plants: Mapping[str, Any]) -> NDArray[np.bool_]:
    """(N,) the plants that do not stand outside; data sets from before there was a column for it have none outside."""
    outside = plants.get("outside", np.zeros(len(plants["species"]), dtype=np.bool_))
    return ~np.asarray(outside, dtype=np.bool_)


def check_renders(
    root: Path, description: Mapping[str, Any], count: int, seed: int, progress: Progress, note: Callable[[str], None]
) -> Iterator[files.Finding]:
    """Files that have other bytes than those that are rendered now.

    `description`: dataset.json.
    `count`, `seed`: how many images; which ones.
    `note`: called if other versions than those of this machine made the data set.
    """
    moved = _moved(description)
    if moved:
        note(f"rendered again with other versions ({moved}): bytes may differ for that reason alone")
    with progress.stage("renders", count) as advance:
        try:
            images = sorted(_drawn_images(root, count, seed).items())
        except (DatasetError, KeyError, TypeError, ValueError) as error:
            yield files.Finding(INDEX_NAME, "the index cannot be read", got=one_line(error))
            return
        for image, rows in images:
            if any(row.get("stopped_by") == "time_budget_s" for row in rows):
                note(f"image {image} is not compared: the clock (render.time_budget_s) has ended its rendering")
                continue
            try:
                yield from _check_image(root, image, rows, progress, moved)
            except OSError as error:
                yield files.Finding(
                    str(rows[0]["folder"]), f"image {image} cannot be read", got=error.strerror or str(error)
                )
            advance(1)


def _drawn_images(root: Path, count: int, seed: int) -> dict[int, list[dict[str, Any]]]:
    """Image -> its rows of the index, of images drawn with equal chances (reservoir sampling, in one pass)."""
    rng = random.Random(f"forestgen verify {seed}")
    kept: dict[int, list[dict[str, Any]]] = {}
    seen, last = 0, -1
    for row in read_index(root / INDEX_NAME):
        image = int(row["image"])
        if image != last:
            seen, last = seen + 1, image
            if len(kept) < count:
                kept[image] = []
            elif rng.random() < count / seen:
                del kept[rng.choice(sorted(kept))]
                kept[image] = []
        if image in kept:
            kept[image].append(row)
    return kept


def _check_image(
    root: Path, image: int, rows: list[dict[str, Any]], progress: Progress, moved: str
) -> Iterator[files.Finding]:
    with TemporaryDirectory(prefix="forestgen-rerender-") as folder:
        fresh = Path(folder) / "fresh"
        fresh.mkdir()
        source = SafePath(root, str(rows[0]["folder"])) / "recipe.yaml"
        try:
            source.size_bytes()  # it is a file of the data set
            again = _render(source.located(), fresh, progress)
        except (ForestgenError, OSError) as error:
            got = str(error).replace("\n", " ")
            yield files.Finding(source.name, "the image cannot be rendered again", got=got)
            return
        names = {str(row["frame"]) for row in rows}
        if names != set(again):
            expected, got = ", ".join(sorted(names)), ", ".join(sorted(again))
            yield files.Finding(
                str(rows[0]["folder"]), f"image {image} has other frames when it is rendered again", expected, got
            )
        for row in rows:
            frame = str(row["frame"])
            if frame in again:
                write_thumbnail(fresh / frame, fresh / thumbnail_name(frame))
                yield from _compare(root, fresh, str(row["folder"]), frame, moved)
                yield from _compare(root, fresh, thumbnail_name(frame), thumbnail_name(frame), moved)
                yield from _compare_rows(row, again[frame])


def _render(source: Path, fresh: Path, progress: Progress) -> dict[str, dict[str, Any]]:
    """Render a drawn recipe again; the frames' rows of the index, by name."""
    from forestgen.dataset.settings import data_set_of
    from forestgen.pipeline import assemble_image, write_image
    from forestgen.recipe.load import load_recipe
    from forestgen.render.variant import mitsuba
    from forestgen.scene.plan import make_plan

    mitsuba(None)
    loaded = load_recipe(source)
    plan = make_plan(loaded.draw(0))
    scene = assemble_image(plan, progress, Timings())
    image = write_image(scene, data_set_of(plan.drawn), fresh, progress, Timings())
    return {str(row["frame"]): row for row in image.rows}


def _compare(root: Path, fresh: Path, kept_name: str, fresh_name: str, moved: str) -> Iterator[files.Finding]:
    """A file, or all files of a folder."""
    kept, made = SafePath(root, kept_name), fresh / fresh_name
    if made.is_file():
        names = [""]
    else:
        below = [path.removeprefix(f"{kept_name}/") for path, _, _ in files_below(root, kept_name)]
        names = sorted({*below, *(path.relative_to(made).as_posix() for path in made.rglob("*") if path.is_file())})
    for name in names:
        one, other = (kept / name, made / name) if name else (kept, made)
        problem = _difference(one, other)
        if problem is not None:
            finding = files.Finding(f"{kept_name}/{name}" if name else kept_name, *problem)
            yield replace(finding, got=f"{finding.got} ({moved})") if moved else finding


def _difference(kept: SafePath, made: Path) -> tuple[str, str, str] | None:
    """Problem, expected, got; None for equal files. What is rendered now is what is expected."""
    if not made.is_file():
        return "rendered again, the image has no such file", "none", "a file"
    if not kept.is_file():
        return "the file is missing", "one, as the image rendered again has it", "none"
    old, new = kept.read(), made.read_bytes()
    if old == new:
        return None
    at = next((at for at, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), min(len(old), len(new)))
    return "rendered again, the file has other bytes", f"{len(new)} bytes", f"{len(old)} bytes, other from byte {at} on"


def _compare_rows(kept: Mapping[str, Any], made: Mapping[str, Any]) -> Iterator[files.Finding]:
    for key, value in made.items():
        if key.startswith("draw."):  # a drawn recipe draws nothing
            continue
        if kept.get(key) != value:
            problem = f"{key} of {made['frame']} is another when it is rendered again"
            yield files.Finding(INDEX_NAME, problem, f"{value!r:.120}", f"{kept.get(key)!r:.120}")


def _moved(description: Mapping[str, Any]) -> str:
    """What is of another version than when the data set was made, for people; "" if nothing is."""
    now = this_version()
    if any(one["versions_hash"] == now["versions_hash"] for one in description["made_with"]):
        return ""
    then = description["made_with"][0]
    packages = [
        f"{name} {then['packages'].get(name)}, now {version}"
        for name, version in now["packages"].items()
        if then["packages"].get(name) != version
    ]
    if then["python"] != now["python"]:
        packages.append(f"Python {then['python']}, now {now['python']}")
    if then["platform"] != now["platform"]:
        packages.append(f"{then['platform']['system']} on {then['platform']['machine']}, now another")
    return "; ".join(packages) or "forestgen's own code"
