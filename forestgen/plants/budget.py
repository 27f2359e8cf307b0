"""Plants and memory: an upper estimate of a plant's triangles, and stopping one that would not fit."""

from __future__ import annotations

from forestgen.core.errors import RecipeError
from forestgen.core.processes import free_bytes

LARGEST_PLANT = 50_000_000  # nodes or organs: no plant needs more, whatever the machine has
_SHARE_OF_FREE = 0.5
_OF_A_SMALL_PLANT, _OF_A_SLENDER_PLANT_PER_M3, _OF_A_WIDE_PLANT_PER_M3 = 20_000, 430, 60_000  # triangles
_OF_A_LARGE_PLANT, _OF_A_LARGE_PLANT_PER_M2 = 240_000, 550


def check_budget(what: str, count: float, bytes_each: int, hint: str) -> None:
    """Refuse a plant of `count` things, before they are made.

    `what`: plural name of the things, such as "leaves". `count`: may be infinite. `bytes_each`: memory that one takes
    while it is made and meshed. `hint`: which keys to change.

    Raises `RecipeError`: more than `LARGEST_PLANT`, or more than half of the memory that is free.
    """
    room = min(float(LARGEST_PLANT), _SHARE_OF_FREE * free_bytes() / bytes_each)
    if not count <= room:
        expected = f"at most {room:,.0f} {what}"
        if room < LARGEST_PLANT:
            expected += " (half of the memory that is free)"
        raise RecipeError(f"the plant would have {count:,.0f} {what}", where="plant", expected=expected, hint=hint)


def most_triangles(height_m: float, width_m: float) -> float:
    """Upper estimate of a plant's triangles at full detail, from its height and the width of its crown, if it has one.

    It holds for all shipped species (docs/species.md; a birch's seeds differ by a tenth). Slender plants have up to 420
    triangles a cubic metre, `height_m` times the square of `width_m`: birch. Low and wide ones have up to 50,000:
    bracken and bramble, whose leaves are divided. Of either kind large ones have fewer: beech 67, oak 68.
    """
    per_m3 = _OF_A_SLENDER_PLANT_PER_M3 if width_m < 0.5 * height_m else _OF_A_WIDE_PLANT_PER_M3
    small = _OF_A_SMALL_PLANT + per_m3 * height_m * width_m**2
    return min(small, _OF_A_LARGE_PLANT + _OF_A_LARGE_PLANT_PER_M2 * height_m * width_m)
