"""Images rendered again, from the drawn recipe that lies with their frames, and compared byte by byte."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from forestgen.core.errors import DatasetError, ForestgenError
from forestgen.core.progress import Progress
from forestgen.core.timing import Timings
from forestgen.dataset.check.finding import Finding
from forestgen.dataset.index import INDEX_NAME, read_index
from forestgen.dataset.safe_path import SafePath
from forestgen.dataset.thumbnails import thumbnail_name, write_thumbnail
from forestgen.runs.description import this_version
from forestgen.runs.finish import files_below

_RECIPE = "recipe.yaml"


def check_renders(
    root: Path, said: Mapping[str, Any], count: int, seed: int, progress: Progress, note: Callable[[str], None]
) -> Iterator[Finding]:
    """Files that have other bytes than those that are rendered now.

    Parameters
    ----------
    said : dataset.json.
    count, seed : how many images; which ones.
    note : told if other versions than those of this machine made the data set.
    """
    moved = _moved(said)
    if moved:
        note(f"rendered again with other versions ({moved}): bytes may differ for that reason alone")
    with progress.stage("renders", count) as advance:
        try:
            images = sorted(_drawn(root, count, seed).items())
        except (DatasetError, KeyError, TypeError, ValueError) as error:
            yield Finding(INDEX_NAME, "the index cannot be read", got=" ".join(str(error).split())[:200])
            return
        for image, rows in images:
            if any(row.get("stopped_by") == "time_budget_s" for row in rows):
                note(f"image {image} is not compared: the clock (render.time_budget_s) has ended its rendering")
                continue
            try:
                yield from _check_image(root, image, rows, progress, moved)
            except OSError as error:
                yield Finding(str(rows[0]["folder"]), f"image {image} cannot be read", got=error.strerror or str(error))
            advance(1)


def _drawn(root: Path, count: int, seed: int) -> dict[int, list[dict[str, Any]]]:
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
) -> Iterator[Finding]:
    with TemporaryDirectory(prefix="forestgen-rerender-") as folder:
        fresh = Path(folder) / "fresh"
        fresh.mkdir()
        source = SafePath(root, str(rows[0]["folder"])) / _RECIPE
        try:
            source.size_bytes()  # it is a file of the data set
            again = _render(source.located(), fresh, progress)
        except (ForestgenError, OSError) as error:
            got = str(error).replace("\n", " ")
            yield Finding(source.name, "the image cannot be rendered again", got=got)
            return
        names = {str(row["frame"]) for row in rows}
        if names != set(again):
            expected, got = ", ".join(sorted(names)), ", ".join(sorted(again))
            yield Finding(
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
    from forestgen.dataset.data_set import data_set_of
    from forestgen.pipeline import assemble_image, write_image
    from forestgen.recipe.load import load_recipe
    from forestgen.render.variant import mitsuba
    from forestgen.scene.planning import make_plan

    mitsuba(None)
    loaded = load_recipe(source)
    plan = make_plan(loaded.draw(0))
    scene = assemble_image(plan, progress, Timings())
    image = write_image(scene, data_set_of(plan.drawn), fresh, progress, Timings())
    return {str(row["frame"]): row for row in image.rows}


def _compare(root: Path, fresh: Path, kept_name: str, fresh_name: str, moved: str) -> Iterator[Finding]:
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
            finding = Finding(f"{kept_name}/{name}" if name else kept_name, *problem)
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
    at = next((place for place, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), min(len(old), len(new)))
    return "rendered again, the file has other bytes", f"{len(new)} bytes", f"{len(old)} bytes, other from byte {at} on"


def _compare_rows(kept: Mapping[str, Any], made: Mapping[str, Any]) -> Iterator[Finding]:
    for key, value in made.items():
        if key.startswith("draw."):  # a drawn recipe draws nothing
            continue
        if kept.get(key) != value:
            problem = f"{key} of {made['frame']} is another when it is rendered again"
            yield Finding(INDEX_NAME, problem, f"{value!r:.120}", f"{kept.get(key)!r:.120}")


def _moved(said: Mapping[str, Any]) -> str:
    """What is of another version than when the data set was made, for people; "" if nothing is."""
    now = this_version()
    if any(one["versions_hash"] == now["versions_hash"] for one in said["made_with"]):
        return ""
    then = said["made_with"][0]
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
