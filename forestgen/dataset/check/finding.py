"""What a check finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Finding:
    """One place where a data set contradicts itself."""

    file: str  # relative to the data set's folder
    problem: str  # one sentence
    expected: str = ""
    got: str = ""
    image: str = ""  # the frame's folder
    plant_id: int | None = None
    pixel: tuple[int, int] | None = None  # x, y from the upper left
    check: str = ""  # name of the check that found it; the runner fills it in

    @property
    def where(self) -> str:
        """File, image, plant and pixel, for people."""
        places = [self.file]
        if self.image and not self.file.startswith(f"{self.image}/"):
            places.append(f"image {self.image}")
        if self.plant_id is not None:
            places.append(f"plant_id {self.plant_id}")
        if self.pixel is not None:
            places.append(f"pixel x {self.pixel[0]}, y {self.pixel[1]}")
        return ", ".join(places)


class UnreadableError(Exception):
    """A file that cannot be read or understood."""

    def __init__(self, finding: Finding) -> None:
        self.finding = finding
        super().__init__(finding.where)


MISUNDERSTOOD = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError)


def misunderstood(file: str, error: Exception, image: str = "", plant_id: int | None = None) -> Finding:
    """The finding of content that a check cannot understand; `error` is one of `MISUNDERSTOOD`."""
    reason = f"{type(error).__name__}: {error}"
    return Finding(file, "the content is not of this format", got=reason[:200], image=image, plant_id=plant_id)


def number(value: Any) -> str:
    """A value of an array in plain figures."""
    if isinstance(value, float | np.floating):
        return f"{float(value):.9g}"
    return str(value.item() if isinstance(value, np.generic) else value)


def numbers(values: Any) -> str:
    """A few values, such as a box or a position."""
    return " ".join(number(value) for value in np.asarray(values).ravel()[:8])
