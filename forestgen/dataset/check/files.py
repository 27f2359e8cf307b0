"""Read a file, or say in one sentence why it cannot be read. The libraries' readers, and none of the writers' code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.finding import Finding, UnreadableError
from forestgen.dataset.exr_chunks import check_chunks
from forestgen.dataset.safe_path import SafePath, check_cells, load_json, one_line

_MOST_YAML, _MOST_LEVELS = 1_000_000, 20


def read_bytes(root: Path, name: str) -> bytes:
    try:
        return SafePath(root, name).read()
    except FileNotFoundError as error:
        raise UnreadableError(Finding(name, "the file is missing")) from error
    except OSError as error:
        raise unreadable(name, error) from error


def read_text(root: Path, name: str) -> str:
    try:
        return read_bytes(root, name).decode("utf-8")
    except UnicodeDecodeError as error:
        raise unreadable(name, error) from error


def read_json(root: Path, name: str) -> Any:
    try:
        return load_json(read_text(root, name))
    except ValueError as error:
        raise UnreadableError(Finding(name, "this is no JSON", got=one_line(error))) from error


def read_yaml(root: Path, name: str) -> Any:
    """A small YAML file, such as YOLO's data.yaml."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    text = read_text(root, name)
    if len(text) > _MOST_YAML:
        raise UnreadableError(Finding(name, "the file is too large", f"{_MOST_YAML:,} characters", f"{len(text):,}"))
    reader = YAML(typ="safe", pure=True)
    reader.max_depth = _MOST_LEVELS
    try:
        return reader.load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise UnreadableError(Finding(name, "this is no YAML", got=one_line(error))) from error


def read_exr(root: Path, name: str) -> tuple[dict[str, dict[str, NDArray[Any]]], dict[str, Any]]:
    """Part -> channel -> (H, W) array in the type it was stored in; and the first part's header."""
    import OpenEXR

    if not read_head(root, name).startswith(b"\x76\x2f\x31\x01"):  # OpenEXR's magic number
        raise UnreadableError(Finding(name, "this is no OpenEXR file"))
    path = SafePath(root, name)
    try:
        with path.open() as stream:
            count = check_chunks(stream)
        parts = OpenEXR.File(str(path.located()), separate_channels=True).parts
        if len(parts) != count:
            raise ValueError(f"{len(parts)} of {count} parts can be read")
        pixels = {part.name(): {c: np.asarray(v.pixels) for c, v in part.channels.items()} for part in parts}
        return pixels, dict(parts[0].header)
    except (OSError, RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise unreadable(name, error) from error


def read_picture(root: Path, name: str) -> NDArray[Any]:
    """(H, W) or (H, W, 3) pixels of a PNG; a palette's indices, not its colours."""
    import warnings

    from PIL import Image

    read_head(root, name)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a picture's size
            with SafePath(root, name).open() as stream, Image.open(stream, formats=("PNG",)) as image:
                return np.asarray(image)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise unreadable(name, error) from error


def read_bit_depth(root: Path, name: str) -> int:
    """Bits a sample of a PNG, or a palette's index, as its header says; of a file without a header 0."""
    header = read_bytes(root, name)[:26]  # signature 8, chunk's length and type 8, width and height 8, bit depth 1
    return header[24] if header[12:16] == b"IHDR" and len(header) == 26 else 0


def read_palette(root: Path, name: str) -> tuple[list[int], dict[str, str]]:
    """Colours of a palette PNG, red, green, blue, red, ..., and its texts; of another PNG no colours."""
    from PIL import Image

    read_head(root, name)
    try:
        with SafePath(root, name).open() as stream, Image.open(stream, formats=("PNG",)) as image:
            image.load()
            texts = {str(key): value for key, value in image.info.items() if isinstance(value, str)}
            return list(image.getpalette() or []), texts
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise unreadable(name, error) from error


def read_table(root: Path, name: str) -> dict[str, NDArray[Any]]:
    """Columns of a Parquet file; null is NaN, and None among texts."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = read_bytes(root, name)
    try:
        with pq.ParquetFile(pa.BufferReader(content)) as file:
            check_cells(file.metadata.num_rows, file.metadata.num_columns)
            table = file.read()
        return {column: table[column].to_numpy() for column in table.column_names}
    except (OSError, ValueError, TypeError, pa.ArrowException) as error:
        raise unreadable(name, error) from error


def read_head(root: Path, name: str) -> bytes:
    """The first bytes of a file, which must be there."""
    try:
        with SafePath(root, name).open() as stream:
            return stream.read(16)
    except FileNotFoundError as error:
        raise UnreadableError(Finding(name, "the file is missing")) from error
    except OSError as error:
        raise unreadable(name, error) from error


def unreadable(name: str, error: Exception) -> UnreadableError:
    return UnreadableError(Finding(name, "the file cannot be read", got=one_line(error)))
