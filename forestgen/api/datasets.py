"""Data sets: `Dataset` reads one, checks it, shows it, packs it; `merge` makes one of several.

PyTorch and Hugging Face's library are optional, and loaded when they are asked for.
"""

from __future__ import annotations

import importlib
import operator
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from forestgen.api.display import display_of
from forestgen.core.arguments import PathLike, path_of, paths_of, shown, text_of, texts_of, whole_of
from forestgen.core.errors import DatasetError, OutputError, RecipeError, ResourceError
from forestgen.core.progress import Progress
from forestgen.dataset.frame import Frame, StoredFrame
from forestgen.dataset.index import INDEX_NAME, plain_rows, whole_index
from forestgen.dataset.png import read_legend
from forestgen.dataset.safe_path import SafePath, unreadable
from forestgen.recipe.suggestions import did_you_mean
from forestgen.runs.description import DATASET_NAME
from forestgen.runs.summary import RunSummary

if TYPE_CHECKING:
    from forestgen.dataset.pack.pack import Packed
    from forestgen.runs.verify import VerificationReport

_PICTURES = ("preview", "semantic", "instance")
_ARRAYS = (
    *_PICTURES, "radiance", "variance", "denoised", "part", "depth", "distance", "position", "normal", "albedo",
    "motion", "sun", "cloud", "boundary", "overlay",
)  # fmt: skip
Transform = Callable[[dict[str, Any]], Any]


class Run:
    """What `Recipe.render` and `Recipe.batch` made: `summary` has counts, times and notes, `dataset` the frames."""

    def __init__(self, summary: RunSummary) -> None:
        self.summary = summary

    @property
    def target(self) -> str:
        """The data set's folder, or its address."""
        return self.summary.target

    @cached_property
    def dataset(self) -> Dataset:
        """Its frames. `RecipeError` where it lies in an object store: a copy on this machine can be read."""
        return Dataset(self.target)

    def __repr__(self) -> str:
        one = self.summary
        return f"<Run {one.target}: {one.already + one.made} of {one.images} images, {one.frames} frames>"


def verify(
    folder: PathLike | Dataset,
    *,
    rerender: int = 0,
    seed: int = 0,
    workers: int | None = None,
    hashes: bool = True,
    progress: bool | Progress | None = None,
) -> VerificationReport:
    """Check files, index, splits and labels of a data set, which may be damaged.

    `ok` of the report says whether all is right, `findings` what is not.

    Parameters
    ----------
    rerender : render so many images again and compare all bytes.
    seed : draws these.
    workers : processes and threads that check; by default one a core.
    hashes : read all files and compare their checksums.

    Raises
    ------
    RecipeError : the folder holds no data set.
    """
    from forestgen.runs.verify import verify as check

    root, display = _folder_of(folder), display_of(progress)
    with display.running():
        return check(root, rerender=rerender, seed=seed, workers=workers, hashes=hashes, progress=display)


def write_report(folder: PathLike | Dataset, out: PathLike | None = None, *, overwrite: bool = False) -> Path:
    """Write the page of a data set, finished or not; the path of it.

    Parameters
    ----------
    out : by default report.html in the data set's folder, which is renewed; else a .html file outside of that folder.
    overwrite : replace another file if it exists.

    Raises
    ------
    OutputError : `out` is no name of a page, or lies in the data set; the page cannot be written.
    """
    from forestgen.dataset.files import check_writable
    from forestgen.dataset.report import page

    root = _folder_of(folder)
    own = root / page.REPORT_NAME
    target = own if out is None else path_of(out, "out", output=True)
    is_own = target.name == own.name and os.path.realpath(target.parent) == os.path.realpath(own.parent)
    if not is_own and root.resolve() in target.resolve().parents:
        expected, hint = "a name outside of the data set's folder", f"leave `out` out, for {own.name} in it"
        problem = "the page would be a stray file of the data set"
        raise OutputError(problem, where=str(target), expected=expected, hint=hint)
    if target.suffix.lower() not in (".html", ".htm"):
        raise OutputError("this is no name of a page", where=str(target), expected="a name that ends in .html")
    if os.path.lexists(target):
        check_writable([target], overwrite=overwrite or is_own)
    page.write_report(root, target)
    return target


def _folder_of(folder: PathLike | Dataset) -> Path:
    return folder.folder if isinstance(folder, Dataset) else path_of(folder, "folder")


class Dataset:
    """A finished data set: a sequence of its frames, whose files are read when they are asked for.

    Parameters
    ----------
    folder : that `Recipe.render`, `Recipe.batch` or `merge` wrote.
    split : name of the one whose frames count; None: those of all.

    Raises
    ------
    RecipeError : there is no such folder, or it holds no data set, or one that is not finished.
    DatasetError : the data set is damaged.
    """

    verify, report = verify, write_report  # of its folder, whole

    def __init__(self, folder: PathLike, split: str | None = None) -> None:
        self.folder = path_of(folder, "folder")
        self._split = split
        _ = self.info  # which refuses what is no data set
        self._rows = whole_index(self.folder / INDEX_NAME)
        if split is not None:
            if text_of(split, "split") not in self.splits:
                raise self._no_split(split)
            self._rows = self._rows.filter(np.asarray(self._rows["split"]) == split)

    @cached_property
    def info(self) -> dict[str, Any]:
        """dataset.json: recipes, versions, counts, splits."""
        from forestgen.runs.verify import open_data_set

        return open_data_set(self.folder)

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of its splits, in the recipe's order."""
        return tuple(self.info["splits"])

    @property
    def index(self) -> Any:
        """A `pyarrow.Table`, a row a frame; `forestgen.dataset.index` has its columns."""
        return self._rows

    @cached_property
    def classes(self) -> tuple[str, ...]:
        """Names of the semantic classes, by number."""
        names = self._legend["semantic"]
        return tuple(names[str(number)] for number in range(len(names)))

    @cached_property
    def categories(self) -> dict[int, str]:
        """Names of the instances' categories, by their number in coco.json."""
        return {int(number): name for number, name in self._legend["categories"].items()}

    def split(self, name: str) -> Dataset:
        """The frames of one split."""
        return Dataset(self.folder, name)

    def __len__(self) -> int:
        return int(self._rows.num_rows)

    def __contains__(self, name: object) -> bool:
        """Whether a frame has this name."""
        return name in self._numbers

    def __iter__(self) -> Iterator[Frame]:
        return (self[number] for number in range(len(self)))

    @overload
    def __getitem__(self, index: int | str) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...

    def __getitem__(self, index: int | str | slice) -> Frame | list[Frame]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        if isinstance(index, str):
            return self.frame(index)
        if not hasattr(index, "__index__"):
            raise TypeError(f"a frame is asked for by its number, a slice or its name, not by {type(index).__name__}")
        number = operator.index(index) + (len(self) if index < 0 else 0)
        if not 0 <= number < len(self):
            raise IndexError(f"the data set has {len(self)} frames, there is none of number {index}")
        row = plain_rows(self._rows.slice(number, 1), self.folder / INDEX_NAME)[0]
        return StoredFrame(SafePath(self.folder, f"{row['split']}/{row['frame']}"), row, self.classes)

    def frame(self, name: str) -> Frame:
        """The frame of a name such as 000000-camera0."""
        if text_of(name, "name") not in self._numbers:
            expected = f"a frame's name, such as {next(iter(self._numbers), 'none: it is empty')}, or its number"
            raise RecipeError("the data set has no such frame", parameter="name", expected=expected, got=shown(name))
        return self[self._numbers[name]]

    def pack(
        self,
        out: PathLike,
        format: str,  # noqa: A002 - the name of the option on the command line
        *,
        shard_size: int | str = "500MB",
        channels: str | Sequence[str] | None = None,
        splits: str | Sequence[str] = (),
        seed: int = 0,
        by_name: bool = False,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> Packed:
        """Write shards for a training program's loader.

        Parameters
        ----------
        format : webdataset (tar files), huggingface (Parquet), or a pack of another package.
        shard_size : bytes, or a text such as 500MB; no file is larger.
        channels : what goes in; by default preview, semantic, instance, and depth and annotations if there are any.
        splits : by default all whose frames are here.
        seed : of the frames' random order.
        by_name : in the order of their names instead.
        """
        from forestgen.dataset.pack.pack import pack

        target = path_of(out, "out", output=True)
        names = None if channels is None else texts_of(channels, "channels")
        wanted = texts_of(splits, "splits") or ([] if self._split is None else [self._split])
        if self._split is not None and wanted != [self._split]:
            problem, got = "these frames are in another split", ", ".join(wanted)
            raise RecipeError(problem, parameter="splits", expected=self._split, got=got)
        display = display_of(progress)
        with display.running():
            return pack(
                self.folder, target, text_of(format, "format"), shard_size=shard_size, channels=names,
                splits=wanted, seed=None if by_name else whole_of(seed, "seed", 0, 2**64 - 1), overwrite=overwrite,
                progress=display,
            )  # fmt: skip

    def as_torch(self, channels: str | Sequence[str] = _PICTURES, transform: Transform | None = None) -> Any:
        """A map-style data set for `torch.utils.data.DataLoader`: a dict of tensors a frame, pictures as (C, H, W).

        Parameters
        ----------
        channels : attributes of `Frame` that are arrays. Ids are int64, as PyTorch has no unsigned integers to index.
        transform : applied to each dict.

        Raises
        ------
        RecipeError : no such array; later, if the data set does not have it.
        ResourceError : PyTorch is not installed.
        """
        return torch_frames(self, texts_of(channels, "channels"), transform)

    def as_huggingface(self) -> Any:
        """A `datasets.DatasetDict` of the splits: preview, semantic and instance pictures, and the index's columns.

        Raises
        ------
        ResourceError : the library datasets is not installed.
        DatasetError : a file is missing, or the library cannot hold a value.
        """
        datasets, splits = _library("datasets"), self.splits if self._split is None else (self._split,)
        made = {split: _huggingface(datasets, self.folder, self._rows, split) for split in splits}
        return datasets.DatasetDict(made)

    @cached_property
    def _numbers(self) -> dict[str, int]:
        """Frame -> number."""
        return {name: number for number, name in enumerate(self._rows["frame"].to_pylist())}

    def _no_split(self, name: str) -> RecipeError:
        """The error for a split that no image is in."""
        declared = {split: share for one in self.info["recipes"] for split, share in one["splits"].items()}
        problem, hint = "the data set has no such split", did_you_mean(name, self.splits)
        if name in declared:
            share, total = declared[name], sum(declared.values())
            part = f"about {100 * share / total:.2g} % of the images are for it; " if share > 0 and total > 0 else ""
            problem += " yet: its recipe declares it, but no image of it is there"
            hint = f"{part}make more, with `resume=True`"
        expected = "one of " + ", ".join(self.splits)
        return RecipeError(problem, parameter="split", expected=expected, got=shown(name), hint=hint)

    @cached_property
    def _legend(self) -> Mapping[str, Any]:
        if not self.splits:
            raise DatasetError("the data set has no split", where=str(self.folder / DATASET_NAME))
        return read_legend(SafePath(self.folder, self.splits[0]))

    def __repr__(self) -> str:
        return f"<Dataset {self.folder}: {len(self)} frames, {', '.join(self.splits)}>"


@dataclass(frozen=True)
class Merged:
    """What `merge` made."""

    folder: Path
    frames: int
    bytes: int
    notes: tuple[str, ...]

    @property
    def dataset(self) -> Dataset:
        return Dataset(self.folder)


def merge(
    sources: PathLike | Sequence[PathLike],
    out: PathLike,
    *,
    link: bool = False,
    overwrite: bool = False,
    progress: bool | Progress | None = None,
) -> Merged:
    """Make one data set of several; pieces of one recipe become what one run would have made, to the last byte.

    Parameters
    ----------
    sources : folders of finished data sets, or one.
    out : its folder.
    link : hard links instead of copies.
    overwrite : replace a previous data set.

    Raises
    ------
    RecipeError, DatasetError, OutputError
    """
    from forestgen.runs.merge import merge as merge_pieces

    pieces, target = paths_of(sources, "sources"), path_of(out, "out", output=True)
    display = display_of(progress)
    with display.running():
        done = merge_pieces(pieces, target, link=link, overwrite=overwrite, progress=display)
    return Merged(target, done.frames, done.bytes, done.notes)


def torch_frames(frames: Dataset, channels: Sequence[str], transform: Transform | None) -> Any:
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


def _huggingface(datasets: Any, folder: Path, index: Any, split: str) -> Any:
    import pyarrow as pa

    rows = plain_rows(index.filter(np.asarray(index["split"]) == split), folder / INDEX_NAME)
    names = [name for name in index.column_names if not pa.types.is_nested(index.schema.field(name).type)]
    plain = {name: [row[name] for row in rows] for name in names}  # a text or a number a frame
    frames = [f"{row['split']}/{row['frame']}" for row in rows]
    pictures = {name: [_located(folder, f"{frame}/{name}.png") for frame in frames] for name in _PICTURES}
    try:
        made = datasets.Dataset.from_dict({**pictures, **plain})
    except (ValueError, TypeError, OverflowError, pa.ArrowException) as error:
        where, got = str(folder / INDEX_NAME), " ".join(str(error).split())[:200]
        raise DatasetError("the library datasets cannot hold the index's values", where=where, got=got) from error
    for name in _PICTURES:
        made = made.cast_column(name, datasets.Image())
    return made


def _located(folder: Path, name: str) -> str:
    """The path of a file, for libraries that open it themselves."""
    path = SafePath(folder, name)
    try:
        return str(path.located())
    except OSError as error:
        raise unreadable(path, error) from error


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
