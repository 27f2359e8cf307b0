"""classes.json: what the numbers in masks and annotations mean.

| key | what it is |
|---|---|
| `semantic` | class number -> name, of semantic.png and of the channels `semantic` |
| `semantic_colours` | class number -> red, green, blue of semantic.png's palette |
| `part` | number -> name, of the channels `part` |
| `categories` | category_id -> name, as in coco.json; panoptic.json adds ground and sky; YOLO counts from 0 |

semantic.png holds `semantic` as JSON in its text `classes`; frame.exr holds `semantic` and `part` in its attributes
``forestgen/classes`` and ``forestgen/parts``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import DatasetError
from forestgen.core.parts import Part
from forestgen.dataset.files import write_bytes
from forestgen.dataset.safe_path import SafePath, unreadable
from forestgen.dataset.settings import DatasetSettings

FILE_NAME = "classes.json"


def write_legend(root: Path, settings: DatasetSettings, palette: NDArray[np.uint8]) -> None:
    """Write classes.json into the data set's folder; `palette` (classes, 3) is the sRGB one of semantic.png."""
    legend = {
        "semantic": _numbered(settings.class_names),
        "semantic_colours": {str(i): colour for i, colour in enumerate(palette.tolist())},
        "part": _numbered(_part_names()),
        "categories": {str(i): name for i, name in enumerate(settings.category_names, start=1)},
    }
    lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(names)}" for key, names in legend.items())
    write_bytes(root / FILE_NAME, f"{{\n{lines}\n}}\n".encode())


def read_legend(split: SafePath) -> dict[str, Any]:
    """classes.json of a split's folder; `semantic` counts from 0 and `categories` from 1, and both have names.

    A file that is missing, damaged, or of another form raises `DatasetError`.
    """
    path = split / FILE_NAME
    try:
        content = path.read_json()
    except (OSError, ValueError) as error:
        raise unreadable(path, error, "forestgen verify checks all files") from error
    for key, first in (("semantic", 0), ("categories", 1)):
        named = content.get(key) if isinstance(content, dict) else None
        is_named = isinstance(named, dict) and all(isinstance(one, str) for one in named.values())
        if not is_named or set(named) != {str(number) for number in range(first, first + len(named))}:
            expected = f"{key}: a name for each number, from {first} on"
            raise DatasetError("a file is not what its name says", where=str(path), expected=expected)
    return dict(content)


def classes_text(class_names: Sequence[str]) -> str:
    """Class number -> name, as JSON on one line."""
    return json.dumps(_numbered(class_names))


def parts_text() -> str:
    """Part number -> name, as JSON on one line."""
    return json.dumps(_numbered(_part_names()))


def _part_names() -> list[str]:
    return [part.name.lower() for part in Part]


def _numbered(names: Sequence[str]) -> dict[str, str]:
    return {str(number): name for number, name in enumerate(names)}
