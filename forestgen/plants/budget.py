"""Stopping a plant that would not fit into memory, before it takes it."""

from __future__ import annotations

from forestgen.core.errors import RecipeError
from forestgen.core.memory import free_bytes

LARGEST_PLANT = 50_000_000  # nodes or organs: no plant needs more, whatever the machine has
_SHARE_OF_FREE = 0.5


def check_budget(what: str, count: float, bytes_each: int, hint: str) -> None:
    """Refuse a plant of `count` things, before they are made.

    Parameters
    ----------
    what : plural name of the things, such as "leaves".
    count : how many; a float may be infinite.
    bytes_each : memory that one takes while it is made and meshed.
    hint : which keys to change.

    Raises
    ------
    RecipeError : more than `LARGEST_PLANT`, or more than half of the memory that is free.
    """
    room = min(float(LARGEST_PLANT), _SHARE_OF_FREE * free_bytes() / bytes_each)
    if not count <= room:
        raise RecipeError(
            f"the plant would have {count:,.0f} {what}",
            where="plant",
            expected=f"at most {room:,.0f} {what} (half of the memory that is free)"
            if room < LARGEST_PLANT
            else f"at most {room:,.0f} {what}",
            hint=hint,
        )
