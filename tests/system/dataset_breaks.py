"""What tests do to copies of a data set: single breaks, and sums that agree with them."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from forestgen.dataset.index import read_index
from forestgen.runs.description import file_groups
from forestgen.runs.record_index import FileSum
from forestgen.runs.records import read_record, record_bytes
from support.data_sets import write_rows

Harm = Callable[[Path], object]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def sum_again(root: Path) -> None:
    """Sums of the files as they are, wherever they are listed, by one who means to deceive and removes the records."""
    shutil.rmtree(root / ".forestgen", ignore_errors=True)
    for path in root.glob("*/manifest.json"):
        manifest = json.loads(path.read_text())
        there = {name: path.parent / name for name in manifest["files"] if (path.parent / name).is_file()}
        manifest["files"] = {
            name: {"bytes": file.stat().st_size, "sha256": digest(file)} for name, file in there.items()
        }
        path.write_text(json.dumps(manifest))
    names = [line[66:] for line in (root / "SHA256SUMS").read_text().splitlines()]
    names = [name for name in names if (root / name).is_file()]
    described = json.loads((root / "dataset.json").read_text())
    counted = [name for name in names if name not in ("README.md", "index.parquet", "dataset.json")]
    described["files"] = file_groups(FileSum(name, (root / name).stat().st_size, "") for name in counted)
    (root / "dataset.json").write_text(json.dumps(described))
    (root / "SHA256SUMS").write_text("".join(f"{digest(root / name)}  {name}\n" for name in names))


def column(root: Path, name: str, values: Any) -> None:
    """Add a column to the index; `values` of each row."""
    path = root / "index.parquet"
    table = pq.read_table(path)
    table = table.append_column(name, pa.array([values] * table.num_rows))
    path.unlink()
    pq.write_table(table, path)


def written(path: Path, content: bytes) -> None:
    """Replace a file, which may be a link to one that others share."""
    path.unlink()
    path.write_bytes(content)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    written(path, bytes(content))


def cut(path: Path) -> None:
    content = path.read_bytes()
    written(path, content[: 2 * len(content) // 3])


def swap(one: Path, other: Path) -> None:
    first, second = one.read_bytes(), other.read_bytes()
    assert first != second
    written(one, second)
    written(other, first)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text, old
    written(path, text.replace(old, new, 1).encode())


def content(path: Path, change: Callable[[Any], object]) -> None:
    """Change a JSON file's content."""
    data = json.loads(path.read_text())
    change(data)
    written(path, json.dumps(data).encode())


def repaint(path: Path, at: tuple[int, int], change: Callable[[Any], Any]) -> None:
    """Change a pixel of a PNG, x and y."""
    with Image.open(path) as image:
        image.load()
        image.putpixel(at, change(image.getpixel(at)))
        aside = path.with_suffix(".new")
        image.save(aside, "PNG", pnginfo=texts_of(image))
    aside.replace(path)


def texts_of(image: Image.Image) -> Any:
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    for key, value in image.info.items():
        if isinstance(value, str):
            info.add_text(key, value)
    return info


def table(path: Path, change: Callable[[dict[str, list[Any]]], object]) -> None:
    """Change the columns of a Parquet file."""
    before = pq.read_table(path)
    columns = before.to_pydict()
    change(columns)
    path.unlink()
    pq.write_table(pa.table(columns, schema=before.schema), path)


def index(root: Path, change: Callable[[list[dict[str, Any]]], object]) -> None:
    """Change the rows of the index."""
    rows = list(read_index(root / "index.parquet"))
    change(rows)
    write_rows(root / "index.parquet", rows)


def record(root: Path, image: int, **changes: Any) -> None:
    """Change a record, whose own sum is right."""
    path = next((root / ".forestgen/jobs").glob(f"{image:06d}-*"))
    path.write_bytes(record_bytes(replace(read_record(path.read_bytes(), ""), **changes)))


def sums_line(root: Path, name: str, change: Callable[[str], str]) -> None:
    """Change the line of SHA256SUMS that lists a file."""
    path = root / "SHA256SUMS"
    lines = path.read_text().splitlines(keepends=True)
    (at,) = [number for number, line in enumerate(lines) if line[66:-1] == name]
    lines[at] = change(lines[at])
    path.write_text("".join(lines))
