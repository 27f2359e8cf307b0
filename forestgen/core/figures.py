"""Numbers and tables for people, and sizes as people write them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from forestgen.core.arguments import shown
from forestgen.core.errors import RecipeError

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
_LONGEST_NUMBER = 19  # characters


def three_digits(value: float) -> str:
    """Such as 0.123, 41.1, 1,230, 1,220,000: rounded to three digits, never with an exponent."""
    return f"{float(f'{value:.3g}'):,.15g}"


def show_bytes(count: float) -> str:
    """Such as 3.2 GB."""
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{three_digits(count / size)} {unit}"
    return f"{three_digits(count / 1e3)} kB"


def seconds(value: float) -> str:
    """A duration for people: 0.41 s, 12 s, 3 min 05 s, 7 h 12 min, 2 d 05 h."""
    if value < 10:
        return f"{value:.2g} s"
    whole = round(value)
    for unit, of_unit, part, of_part in (("d", 86400, "h", 3600), ("h", 3600, "min", 60), ("min", 60, "s", 1)):
        if whole >= of_unit:
            return f"{whole // of_unit:,} {unit} {whole % of_unit // of_part:02d} {part}"
    return f"{whole} s"


def count(number: int, one: str, many: str | None = None) -> str:
    """A number with its noun: 1 image, 2 images."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def table_lines(rows: Sequence[Sequence[str]], *, names_left: bool = True) -> list[str]:
    """Rows as wide as they must be, the first column to the left, where it has names, and the others to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [text.rjust(width) for text, width in zip(row, widths, strict=True)]
        if names_left:
            cells[0] = row[0].ljust(widths[0])
        lines.append("  ".join(cells).rstrip())
    return lines


def parse_bytes(size: int | str, option: str) -> int:
    """Bytes of a number, or of a text such as 500MB (decimal), 1.5 GB or 256MiB (binary); `RecipeError` for others."""
    text = size if isinstance(size, str) else shown(size)
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?i?)b?\s*", text, re.IGNORECASE | re.ASCII)
    unit = found[2].lower() if found else None
    if found is not None and unit in _UNITS and len(found[1]) <= _LONGEST_NUMBER:
        number = int(float(found[1]) * _UNITS[unit])
        if number > 0:
            return number
    raise RecipeError("this is no size", parameter=option, expected="such as 500MB, 1.5GB or 256MiB", got=shown(size))
