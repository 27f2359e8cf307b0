"""Numbers for people."""

from __future__ import annotations


def three_digits(value: float) -> str:
    """Such as 0.123, 41.1, 1,230, 1,220,000: rounded to three digits, never with an exponent."""
    return f"{float(f'{value:.3g}'):,.15g}"


def show_bytes(count: float) -> str:
    """Such as 3.2 GB."""
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{three_digits(count / size)} {unit}"
    return f"{three_digits(count / 1e3)} kB"
