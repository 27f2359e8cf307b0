"""Data sets as PyTorch and Hugging Face's library have them. Both are optional, and loaded when they are asked for."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from forestgen.core.errors import DatasetError, RecipeError, ResourceError
from forestgen.dataset.index import INDEX_NAME, plain_rows
from forestgen.dataset.safe_path import SafePath, unreadable
from forestgen.recipe.suggestions import did_you_mean

if TYPE_CHECKING:
    from forestgen.dataset.frame import Frame

PICTURES = ("preview", "semantic", "instance")
_ARRAYS = (
    *PICTURES, "radiance", "variance", "denoised", "part", "depth", "distance", "position", "normal", "albedo",
    "motion", "sun", "cloud", "boundary", "overlay",
)  # fmt: skip
Transform = Callable[[dict[str, Any]], Any]


def torch_frames(frames: Sequence[Frame], channels: Sequence[str], transform: Transform | None) -> Any:
    """See `Dataset.as_torch`. The class is made here, as PyTorch may be missing or slow to load."""
    for name in channels:
        if name not in _ARRAYS:
            expected, hint = "one of " + ", ".join(_ARRAYS), did_you_mean(str(name), _ARRAYS)
            raise RecipeError(
                "frames have no such array", parameter="channels", expected=expected, got=repr(name), hint=hint
            )
    torch = _library("torch")
    data = _library("torch.utils.data")

    class Frames(data.Dataset):  # type: ignore[misc,name-defined]
        def __len__(self) -> int:
            return len(frames)

        def __getitem__(self, index: int) -> Any:
            frame = frames[index]
            item = {name: torch.from_numpy(_for_torch(name, getattr(frame, name))) for name in channels}
            return item if transform is None else transform(item)

        def __reduce__(self) -> Any:  # for loaders whose processes do not fork
            return torch_frames, (frames, channels, transform)

    return Frames()


def huggingface_splits(folder: Path, rows: Any, splits: Sequence[str]) -> Any:
    """See `Dataset.as_huggingface`.

    Parameters
    ----------
    rows : the index, a `pyarrow.Table`.
    """
    datasets = _library("datasets")
    return datasets.DatasetDict({split: _huggingface(datasets, folder, rows, split) for split in splits})


def _huggingface(datasets: Any, folder: Path, index: Any, split: str) -> Any:
    import pyarrow as pa

    rows = plain_rows(index.filter(np.asarray(index["split"]) == split), folder / INDEX_NAME)
    plain = {name: [row[name] for row in rows] for name in index.column_names if _is_plain(index, name)}
    try:
        made = datasets.Dataset.from_dict({**_paths(folder, rows), **plain})
    except (ValueError, TypeError, OverflowError, pa.ArrowException) as error:
        where, got = str(folder / INDEX_NAME), " ".join(str(error).split())[:200]
        raise DatasetError("the library datasets cannot hold the index's values", where=where, got=got) from error
    for name in PICTURES:
        made = made.cast_column(name, datasets.Image())
    return made


def _paths(folder: Path, rows: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Picture -> its files."""
    return {name: [_located(folder, f"{row['split']}/{row['frame']}/{name}.png") for row in rows] for name in PICTURES}


def _located(folder: Path, name: str) -> str:
    """The path of a file, for libraries that open it themselves."""
    path = SafePath(folder, name)
    try:
        return str(path.located())
    except OSError as error:
        raise unreadable(path, error, "forestgen verify checks all files") from error


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        hint = f"uv pip install {package}"
        raise ResourceError(f"the library {package} cannot be loaded", got=str(error), hint=hint) from error


def _for_torch(name: str, values: Any) -> Any:
    """A copy that may be written to, as tensors may."""
    if values is None:
        hint = "labels.channels of the recipe chooses them"
        raise RecipeError("the data set has no such channel", parameter="channels", got=name, hint=hint)
    array = np.moveaxis(values, -1, 0) if values.ndim == 3 else values
    return np.array(array, dtype=np.int64 if array.dtype == np.uint32 else array.dtype, order="C")


def _is_plain(table: Any, name: str) -> bool:
    """Whether a column holds a text or a number a frame."""
    import pyarrow as pa

    return not pa.types.is_nested(table.schema.field(name).type)
