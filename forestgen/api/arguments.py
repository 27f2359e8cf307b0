"""Arguments that several functions take."""

from __future__ import annotations

import os
from typing import Any


def several(values: Any) -> tuple[Any, ...]:
    """Several values, or one text or path, which is a single value and no sequence of letters."""
    return (values,) if isinstance(values, str | os.PathLike) else tuple(values)
