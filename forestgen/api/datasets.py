"""Data sets: `Dataset` reads one, checks it, shows it, packs it; `merge` makes one of several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from forestgen.api.display import display_of
from forestgen.core.arguments import MOST_SEEDS, PathLike, path_of, paths_of, shown, text_of, texts_of, whole_of
from forestgen.core.errors import DatasetError, RecipeError
from forestgen.core.progress import Progress
from forestgen.dataset.frame import Frame, StoredFrame
from forestgen.dataset.index import INDEX_NAME, whole_index
from forestgen.dataset.legend import FILE_NAME as LEGEND_NAME
from forestgen.dataset.safe_path import SafePath, unreadable
from forestgen.runs.summary import RunSummary

if TYPE_CHECKING:
    from forestgen.dataset.pack.run import Packed
    from forestgen.runs.verify_report import VerificationReport

_TORCH_CHANNELS = ("preview", "semantic", "instance")
_ARRAYS = (
    *_TORCH_CHANNELS, "radiance", "variance", "denoised", "part", "depth", "distance", "position", "normal", "albedo",
    "motion", "sun", "cloud", "boundary", "overlay",
)  # fmt: skip


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
        return Dataset(self.target)

    def __repr__(self) -> str:
        one = self.summary
        return f"<Run {one.target}: {one.already + one.made} of {one.images} images, {one.frames} frames>"


class Dataset(Sequence[Frame]):
    """A finished data set: a sequence of its frames, whose files are read when they are asked for.

    Parameters
    ----------
    folder : that `Recipe.render`, `Recipe.batch` or `merge` wrote.
    split : name of the one whose frames count; None: those of all.

    Raises
    ------
    DatasetError : the folder holds no data set, or one that is not finished or damaged.
    """

    def __init__(self, folder: PathLike, split: str | None = None) -> None:
        self.folder = path_of(folder, "folder")
        self._split = split
        self._rows = _rows_of(self.folder)
        if split is not None:
            if split not in self.splits:
                expected = "one of " + ", ".join(self.splits)
                raise RecipeError("the data set has no such split", expected=expected, got=shown(split))
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
        names = self._legend.get("semantic", {})
        return tuple(names[str(number)] for number in range(len(names)))

    @cached_property
    def categories(self) -> dict[int, str]:
        """Names of the instances' categories, by their number in coco.json."""
        return {int(number): name for number, name in self._legend.get("categories", {}).items()}

    def split(self, name: str) -> Dataset:
        """The frames of one split."""
        return Dataset(self.folder, name)

    def __len__(self) -> int:
        return int(self._rows.num_rows)

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...

    def __getitem__(self, index: int | slice) -> Frame | list[Frame]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        number = index + len(self) if index < 0 else index
        if not 0 <= number < len(self):
            raise IndexError(f"the data set has {len(self)} frames, there is none of number {index}")
        row = self._rows.slice(number, 1).to_pylist(maps_as_pydicts="strict")[0]
        return Frame(StoredFrame(SafePath(self.folder, f"{row['split']}/{row['frame']}"), row, self.classes))

    def frame(self, name: str) -> Frame:
        """The frame of a name such as 000000-camera0."""
        names = self._rows["frame"].to_pylist()
        if name not in names:
            raise RecipeError("the data set has no such frame", where=str(self.folder), got=shown(name))
        number: int = names.index(name)
        return self[number]

    def verify(
        self,
        *,
        rerender: int = 0,
        seed: int = 0,
        workers: int | None = None,
        hashes: bool = True,
        progress: bool | Progress | None = None,
    ) -> VerificationReport:
        """Check files, index, splits and labels. `ok` of the report says whether all is right, `findings` what is not.

        Parameters
        ----------
        rerender : render so many images again and compare all bytes.
        seed : draws these.
        workers : processes and threads that check; by default one a core.
        hashes : read all files and compare their checksums.
        """
        return verify(self.folder, rerender=rerender, seed=seed, workers=workers, hashes=hashes, progress=progress)

    def report(self, out: PathLike | None = None) -> Path:
        """Write the data set's page, by default report.html in its folder; the path of it."""
        return write_report(self.folder, out)

    def pack(
        self,
        out: PathLike,
        format: str,  # noqa: A002 - the name of the option on the command line
        *,
        shard_size: int | str = "500MB",
        channels: Sequence[str] | str | None = None,
        splits: Sequence[str] | str = (),
        seed: int = 0,
        by_name: bool = False,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> Packed:
        """Write shards for a loader: webdataset (tar files) or huggingface (Parquet).

        Parameters
        ----------
        shard_size : bytes, or a text such as 500MB; no file is larger.
        channels : what goes in; by default preview, semantic, instance, and depth and annotations if there are any.
        splits : by default all.
        seed : of the frames' random order.
        by_name : in the order of their names instead.
        """
        from forestgen.dataset.pack.run import pack, packing_of

        target = path_of(out, "out", output=True)
        names = None if channels is None else texts_of(channels, "channels")
        order = None if by_name else whole_of(seed, "seed", 0, MOST_SEEDS)
        packing = packing_of(text_of(format, "format"), shard_size, names, texts_of(splits, "splits"), order)
        display = display_of(progress)
        with display.running():
            return pack(self.folder, target, packing, overwrite=overwrite, progress=display)

    def as_torch(
        self, channels: Sequence[str] = _TORCH_CHANNELS, transform: Callable[[dict[str, Any]], Any] | None = None
    ) -> Any:
        """A map-style data set for `torch.utils.data.DataLoader`: a dict of tensors a frame, pictures as (C, H, W).

        Parameters
        ----------
        channels : attributes of `Frame` that are arrays. Ids are int64, as PyTorch has no unsigned integers to index.
        transform : applied to each dict.

        Raises
        ------
        RecipeError : no such array; later, if the data set does not have it.
        """
        names = texts_of(channels, "channels")
        for name in names:
            if name not in _ARRAYS:
                expected = "of " + ", ".join(_ARRAYS)
                raise RecipeError("frames have no such array", where="channels", expected=expected, got=shown(name))
        return _torch_frames(self, tuple(names), transform)

    def as_huggingface(self) -> Any:
        """A `datasets.DatasetDict` of the splits: preview, semantic and instance pictures, and the index's columns."""
        import datasets

        splits = (self._split,) if self._split is not None else self.splits
        return datasets.DatasetDict({split: self._as_huggingface(datasets, split) for split in splits})

    def _as_huggingface(self, datasets: Any, split: str) -> Any:
        rows = self._rows.filter(np.asarray(self._rows["split"]) == split).to_pylist(maps_as_pydicts="strict")
        plain = {name: [row[name] for row in rows] for name in self._rows.column_names if _is_plain(self._rows, name)}
        pictures = ("preview", "semantic", "instance")
        paths = {
            name: [self._located(f"{row['split']}/{row['frame']}/{name}.png") for row in rows] for name in pictures
        }
        made = datasets.Dataset.from_dict({**paths, **plain})
        for name in pictures:
            made = made.cast_column(name, datasets.Image())
        return made

    def _located(self, name: str) -> str:
        """The path of a file, for libraries that open it themselves."""
        path = SafePath(self.folder, name)
        try:
            return str(path.located())
        except OSError as error:
            raise unreadable(path, error, "forestgen verify checks all files") from error

    @cached_property
    def _legend(self) -> Mapping[str, Any]:
        path = SafePath(self.folder, self.splits[0]) / LEGEND_NAME
        try:
            content = path.read_json()
        except (OSError, ValueError) as error:
            raise unreadable(path, error) from error
        if not isinstance(content, dict):
            raise DatasetError("the file holds no classes", where=str(path))
        return content

    def __iter__(self) -> Iterator[Frame]:
        return (self[number] for number in range(len(self)))

    def __repr__(self) -> str:
        return f"<Dataset {self.folder}: {len(self)} frames, {', '.join(self.splits)}>"


def verify(
    folder: PathLike,
    *,
    rerender: int = 0,
    seed: int = 0,
    workers: int | None = None,
    hashes: bool = True,
    progress: bool | Progress | None = None,
) -> VerificationReport:
    """Check a data set that may be damaged; see `Dataset.verify`. Raises `RecipeError` if the folder holds none."""
    from forestgen.runs.verify import verify as check

    root = path_of(folder, "folder")
    again, drawn = whole_of(rerender, "rerender", 0, 10**9), whole_of(seed, "seed", 0, MOST_SEEDS)
    jobs = None if workers is None else whole_of(workers, "workers", 1, 1024)
    display = display_of(progress)
    with display.running():
        return check(root, rerender=again, seed=drawn, workers=jobs, hashes=hashes, progress=display)


def write_report(folder: PathLike, out: PathLike | None = None) -> Path:
    """Write the page of a data set, finished or not; the path of it. See `Dataset.report`."""
    from forestgen.dataset.report import page

    root = path_of(folder, "folder")
    target = root / page.REPORT_NAME if out is None else path_of(out, "out", output=True)
    page.write_report(root, target)
    return target


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
    sources: Sequence[PathLike] | PathLike,
    out: PathLike,
    *,
    link: bool = False,
    progress: bool | Progress | None = None,
) -> Merged:
    """Make one data set of several; pieces of one recipe become what one run would have made, to the last byte.

    Parameters
    ----------
    sources : folders of finished data sets.
    out : a new or empty folder.
    link : hard links instead of copies.

    Raises
    ------
    RecipeError, DatasetError, OutputError
    """
    from forestgen.runs.merge import merge as merge_pieces

    pieces, target = paths_of(sources, "sources"), path_of(out, "out", output=True)
    display = display_of(progress)
    with display.running():
        done = merge_pieces(pieces, target, link=link, progress=display)
    return Merged(target, done.frames, done.bytes, done.notes)


def _rows_of(folder: Path) -> Any:
    from forestgen.runs.verify import open_data_set

    try:
        open_data_set(folder)
    except RecipeError as error:  # it says what the folder is instead
        raise DatasetError(
            error.problem, where=error.where, expected=error.expected, got=error.got, hint=error.hint
        ) from error
    return whole_index(folder / INDEX_NAME)


def _torch_frames(frames: Dataset, channels: tuple[str, ...], transform: Callable[[dict[str, Any]], Any] | None) -> Any:
    """See `Dataset.as_torch`. The class is made here, as PyTorch may be missing or slow to load."""
    import torch.utils.data

    class Frames(torch.utils.data.Dataset):  # type: ignore[misc]
        def __len__(self) -> int:
            return len(frames)

        def __getitem__(self, index: int) -> Any:
            frame = frames[index]
            item = {name: torch.from_numpy(_for_torch(name, getattr(frame, name))) for name in channels}
            return item if transform is None else transform(item)

        def __reduce__(self) -> Any:  # for loaders whose processes do not fork
            return _torch_frames, (frames, channels, transform)

    return Frames()


def _for_torch(name: str, values: Any) -> Any:
    """A copy that may be written to, as tensors may."""
    if values is None:
        hint = "labels.channels of the recipe chooses them"
        raise RecipeError("the data set has no such channel", where="channels", got=name, hint=hint)
    array = np.moveaxis(values, -1, 0) if values.ndim == 3 else values
    return np.array(array, dtype=np.int64 if array.dtype == np.uint32 else array.dtype, order="C")


def _is_plain(table: Any, name: str) -> bool:
    """Whether a column holds a text or a number a frame."""
    import pyarrow as pa

    return not pa.types.is_nested(table.schema.field(name).type)
