"""Finished images that a run would remove: they are removed only after confirmation."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from forestgen.core.errors import ForestgenError, RecipeError
from forestgen.dataset.check.finding import UnreadableError
from forestgen.recipe.load import LoadedRecipe
from forestgen.runs.contract import StorageBackend
from forestgen.runs.finish import recipe_part
from forestgen.runs.folder import images_in_frames, is_made_from
from forestgen.runs.keys import image_of_key, job_key
from forestgen.runs.records import done_keys
from forestgen.runs.verify_index import plain_yaml

_MOST_CHANGES = 4  # that are named
_MANY = 1000  # images whose comparison takes long enough to say so


@dataclass(frozen=True)
class ResumeDiff:
    """The finished images of a batch, as a run with another recipe or count would find them."""

    kept: int
    beyond: int  # whose numbers are not among the images that are wanted
    stale: frozenset[int]  # that the recipe, or these versions, would make otherwise now
    unrecorded: int = 0  # that have frames and no record, and that this run would not make again as they are
    changes: str = ""  # what the recipe says otherwise than the data set's own, as far as that is known

    @property
    def discarded(self) -> int:
        """How many would be thrown away."""
        return self.beyond + len(self.stale) + self.unrecorded

    def reasons(self) -> str:
        """Why, for people."""
        other = "made from another recipe, for another split, or by other versions"
        parts = [
            (self.beyond, "beyond the images that are asked for now"),
            (len(self.stale), other + (f" ({self.changes})" if self.changes else "")),
            (self.unrecorded, "that have lost their records, by which they are recognised"),
        ]
        return "; ".join(f"{number:,} {reason}" for number, reason in parts if number)


def resume_diff(
    storage: StorageBackend, loaded: LoadedRecipe, images: range, mark: str, versions: str, say: Callable[[str], None]
) -> ResumeDiff:
    """Compare the finished images with what is wanted now; removes nothing.

    Parameters
    ----------
    images : numbers of the images that are wanted.
    mark, versions : see `folder.fingerprint`.
    say : told if it takes a while: of a recipe that has changed, each finished image is drawn again.
    """
    keys = done_keys(storage)
    mine = {image: key for key in keys if (image := image_of_key(key)) in images}
    recorded = {image_of_key(key) for key in keys}
    beyond = len(recorded - mine.keys())
    unrecorded = images_in_frames(storage, loaded.splits) - recorded
    if is_made_from(storage, mark):
        return ResumeDiff(len(mine), beyond, frozenset(), len(unrecorded.difference(images)))
    if len(mine) >= _MANY:
        say(f"comparing {len(mine):,} finished images with the recipe, which has changed")
    stale = frozenset(image for image in mine if _key(loaded, image - images.start, versions) not in keys)
    changes = _changes(storage, loaded) if stale else ""
    return ResumeDiff(len(mine) - len(stale), beyond, stale, len(unrecorded), changes)


def check_stale_outputs(found: ResumeDiff, where: str, *, agreed: bool) -> None:
    """Refuse to throw finished images away unasked.

    Raises
    ------
    RecipeError : images would be lost, and nobody has agreed.
    """
    if found.discarded and not agreed:
        raise RecipeError(
            f"this would throw away {found.discarded:,} of {found.kept + found.discarded:,} finished images",
            where=where,
            expected="the recipe, the numbers of images and the versions that the batch was begun with, or more images",
            got=found.reasons(),
            hint="`discard=True` agrees to it; or choose another folder",
        )


def _key(loaded: LoadedRecipe, index: int, versions: str) -> str:
    """Of an image as it would be made now; "" if it cannot be drawn."""
    try:
        return job_key(loaded.draw(index), versions)
    except ForestgenError:
        return ""


def _changes(storage: StorageBackend, loaded: LoadedRecipe) -> str:
    """What the recipe says otherwise than recipe.yaml of the data set; "" where neither can tell."""
    try:
        before = plain_yaml((storage.read("recipe.yaml") or b"").decode(), "")
        now = plain_yaml(recipe_part(loaded, ()).yaml, "")
    except (ForestgenError, UnreadableError, UnicodeDecodeError):
        return ""
    for content in (before, now):
        content.pop("images", None)
        content.pop("first_image", None)
    found = list(_differences(before, now))
    more = f"; {len(found) - _MOST_CHANGES} more" if len(found) > _MOST_CHANGES else ""
    return "; ".join(found[:_MOST_CHANGES]) + more


def _differences(before: Any, now: Any, where: str = "") -> Iterator[str]:
    """Keys whose values differ, with both."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in sorted({*before, *now}, key=str):
            yield from _differences(before.get(key), now.get(key), f"{where}.{key}" if where else str(key))
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for number, (old, new) in enumerate(zip(before, now, strict=True)):
            yield from _differences(old, new, f"{where}.{number}")
    elif before != now:
        yield f"{where:.60} was {reprlib.repr(before)}, is now {reprlib.repr(now)}"
