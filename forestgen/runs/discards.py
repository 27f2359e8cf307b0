"""Finished images that a run would remove: they are removed only after confirmation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from forestgen.core.errors import ForestgenError, RecipeError
from forestgen.recipe.load import LoadedRecipe
from forestgen.runs.contract import Place
from forestgen.runs.folder import is_made_from
from forestgen.runs.keys import image_of_key, job_key
from forestgen.runs.records import done_keys

_MANY = 1000  # images whose comparison takes long enough to say so


@dataclass(frozen=True)
class Standing:
    """The finished images of a batch, as a run with another recipe or count would find them."""

    kept: int
    beyond: int  # whose numbers are not among the images that are wanted
    stale: frozenset[int]  # that the recipe, or these versions, would make otherwise now

    @property
    def discarded(self) -> int:
        """How many would be thrown away."""
        return self.beyond + len(self.stale)

    def reasons(self) -> str:
        """Why, for people."""
        parts = [
            (self.beyond, "beyond the images that are asked for now"),
            (len(self.stale), "made from another recipe, for another split, or by other versions"),
        ]
        return "; ".join(f"{number:,} {reason}" for number, reason in parts if number)


def standing(
    place: Place, loaded: LoadedRecipe, images: range, mark: str, versions: str, say: Callable[[str], None]
) -> Standing:
    """Compare the finished images with what is wanted now; removes nothing.

    Parameters
    ----------
    images : numbers of the images that are wanted.
    mark, versions : see `folder.fingerprint`.
    say : told if it takes a while: of a recipe that has changed, each finished image is drawn again.
    """
    keys = done_keys(place)
    mine = {image: key for key in keys if (image := image_of_key(key)) in images}
    beyond = len({image_of_key(key) for key in keys} - mine.keys())
    if is_made_from(place, mark):
        return Standing(len(mine), beyond, frozenset())
    if len(mine) >= _MANY:
        say(f"comparing {len(mine):,} finished images with the recipe, which has changed")
    stale = frozenset(image for image in mine if _key(loaded, image - images.start, versions) not in keys)
    return Standing(len(mine) - len(stale), beyond, stale)


def check_discards(found: Standing, where: str, *, agreed: bool) -> None:
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
