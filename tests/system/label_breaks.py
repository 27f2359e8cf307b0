"""Ways to break one thing in a data set, for the test that the checker finds it.

A break is a function of the data set's folder. Those of a pixel take a spot: a kind of place that the image has.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

FRAME, NEXT = "000000-walk-0000", "000000-walk-0001"
BIRCH, HIDDEN = 1, 4  # plants: one in the middle of the image, and one behind it

Break = Callable[[Path], None]
Pixel = tuple[int, int]


@cache
def spots(root: Path) -> dict[str, Pixel]:
    """x, y of a pixel of each kind: BIRCH's crown, ground and sky that fill their pixels, and a pixel of two ids.

    The first break of a folder finds them; later ones keep to them.
    """
    import OpenEXR

    opened = OpenEXR.File(str(root / FRAME / "frame.exr"), separate_channels=True)
    parts = {part.name(): {name: one.pixels for name, one in part.channels.items()} for part in opened.parts}
    identity, full = parts["identity"], parts["coverage"]["rank0.coverage"] == 1
    own, centre = identity["plant_id"], identity["centre.plant_id"]
    masks = {
        "birch": (own == BIRCH) & (centre == BIRCH) & (identity["part"] == 4),
        "ground": full & (own == 0) & (centre == 0) & (identity["centre.part"] == 1),
        "sky": full & (own == 0) & (identity["centre.part"] == 0),
        "mixed": (own == BIRCH) & (parts["coverage"]["rank1.coverage"] > 0),
    }
    found = {}
    for name, mask in masks.items():
        y, x = np.argwhere(mask)[np.count_nonzero(mask) // 2].tolist()
        found[name] = (x, y)
    return found


def exr(
    part: str, channel: str, change: Any, spot: str | None = None, file: str = "frame.exr", frame: str = FRAME
) -> Break:
    """Give a channel of an EXR another value, in a spot or everywhere; a function takes the old values to new ones."""

    def make(root: Path) -> None:
        import OpenEXR

        where: Any = ... if spot is None else spots(root)[spot][::-1]
        path = root / frame / file
        opened = OpenEXR.File(str(path), separate_channels=True)
        chosen = next(one for one in opened.parts if part in ("", one.name()))
        pixels = chosen.channels[channel].pixels
        pixels[where] = change(pixels[where]) if callable(change) else change
        opened.write(str(path))

    return make


def picture(name: str, change: Any, spot: str) -> Break:
    """Give a pixel of a PNG, of colours or of indices, another value."""

    def make(root: Path) -> None:
        from PIL import Image
        from PIL.PngImagePlugin import PngInfo

        x, y = spots(root)[spot]
        with Image.open(root / name) as image:
            palette = image.getpalette() if image.mode == "P" else None
            texts = PngInfo()
            for key, value in image.text.items():
                texts.add_text(key, value)
            pixels = np.array(image)
        pixels[y, x] = change(pixels[y, x]) if callable(change) else change
        changed = Image.fromarray(pixels)
        if palette is not None:
            changed.putpalette(palette)
        (root / name).unlink()  # it may be linked with another file of the data set
        changed.save(root / name, pnginfo=texts)

    return make


def table(change: Callable[[dict[str, list[Any]]], None]) -> Break:
    """Change the columns of plants.parquet, lists of plain values in the order of plant_id 1, 2, ..."""

    def make(root: Path) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = root / FRAME / "plants.parquet"
        old = pq.read_table(path)
        columns = old.to_pydict()
        change(columns)
        kinds = {name: old.schema.field(name).type for name in columns}
        pq.write_table(pa.table({name: pa.array(columns[name], type=kinds[name]) for name in columns}), path)

    return make


def cell(column: str, value: Any, plant: int = BIRCH) -> Break:
    """Set a cell of plants.parquet."""
    return table(lambda columns: columns[column].__setitem__(plant - 1, value))


def content(name: str, change: Callable[[Any], None]) -> Break:
    """Change a JSON file."""

    def make(root: Path) -> None:
        values = json.loads((root / name).read_text())
        change(values)
        (root / name).write_text(json.dumps(values))

    return make


def annotation(key: str, value: Any, plant: int = BIRCH) -> Break:
    """Set or change a field of a plant's annotation, in coco.json and in the frame's own share alike."""

    def change(values: Any) -> None:
        image = values.get("images", [{}])[0].get("id")
        for one in values["annotations"]:
            if one["plant_id"] == plant and one.get("image_id") == image:
                one[key] = value(one[key]) if callable(value) else value

    def make(root: Path) -> None:
        content("coco.json", change)(root)
        content(f"{FRAME}/annotations.json", change)(root)

    return make


def turned(root: Path, code: dict[str, Any], spot: str) -> dict[str, Any]:
    """A run-length code with one pixel turned over."""
    from pycocotools import mask

    x, y = spots(root)[spot]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # pycocotools' arrays are of NumPy 1's protocol
        pixels = np.asfortranarray(mask.decode(code))
        pixels[y, x] ^= 1
        other = mask.encode(pixels)
    return {"size": other["size"], "counts": other["counts"].decode()}


def turned_mask(key: str, spot: str) -> Break:
    """Turn a pixel of BIRCH's run-length code over."""
    return lambda root: annotation(key, lambda code: turned(root, code, spot))(root)


def cut(name: str, keep: float = 0.6) -> Break:
    """Truncate a file."""

    def make(root: Path) -> None:
        data = (root / name).read_bytes()
        (root / name).unlink()
        (root / name).write_bytes(data[: int(len(data) * keep)])

    return make


def untold(name: str) -> Break:
    """Take the texts out of a palette PNG."""

    def make(root: Path) -> None:
        from PIL import Image

        with Image.open(root / name) as image:
            image.load()
        image.save(root / name)

    return make


def short_palette(name: str) -> Break:
    """Write a palette PNG with 4 bits a pixel, as Pillow does where its palette has few colours."""

    def make(root: Path) -> None:
        from PIL import Image
        from PIL.PngImagePlugin import PngInfo

        texts = PngInfo()
        with Image.open(root / name) as image:
            image.load()
        for key, value in image.text.items():
            texts.add_text(key, value)
        (root / name).unlink()  # it may be linked with another file of the data set
        image.save(root / name, bits=4, pnginfo=texts)

    return make


def gone(name: str) -> Break:
    return lambda root: (root / name).unlink()


def text(name: str, new: str | bytes) -> Break:
    def make(root: Path) -> None:
        (root / name).unlink()
        (root / name).write_bytes(new if isinstance(new, bytes) else new.encode())

    return make


def lines(name: str, change: Callable[[list[str]], None]) -> Break:
    """Change the lines of a text file."""

    def make(root: Path) -> None:
        values = (root / name).read_text().splitlines()
        change(values)
        text(name, "".join(line + "\n" for line in values))(root)

    return make


def numbers(line: str, index: int, change: Callable[[float], float]) -> str:
    """A line of numbers with one of them changed."""
    words = line.split()
    words[index] = f"{change(float(words[index])):.9f}"
    return " ".join(words)


def points(change: Callable[[np.ndarray], None]) -> Break:
    """Change the records of points.ply."""

    def make(root: Path) -> None:
        path = root / FRAME / "points.ply"
        head, mark, body = path.read_bytes().partition(b"end_header\n")
        kinds = {"double": "<f8", "float": "<f4", "uchar": "u1", "ushort": "<u2", "uint": "<u4"}
        words = [line.split() for line in head.decode().splitlines() if line.startswith("property")]
        records = np.frombuffer(body, np.dtype([(word[2], kinds[word[1]]) for word in words])).copy()
        change(records)
        path.write_bytes(head + mark + records.tobytes())

    return make


def moved(values: dict[str, Any]) -> None:
    """A camera 10 cm further east, in all fields."""
    pose, position = np.array(values["camera_from_world"]), np.array(values["position_m"])
    position[0] += 0.1
    pose[:3, 3] = -pose[:3, :3] @ position
    values["camera_from_world"], values["position_m"] = pose.tolist(), position.tolist()


def all_of(*breaks: Break) -> Break:
    """Several files that tell the same lie."""

    def make(root: Path) -> None:
        for one in breaks:
            one(root)

    return make


def without_row(plant: int) -> Break:
    """plants.parquet without a plant."""
    return table(lambda columns: [values.pop(plant - 1) for values in columns.values()] and None)
