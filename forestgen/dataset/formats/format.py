"""What a data set format is, how one is found by its name, and what most of them need.

That is the shard of a frame, the file over all frames, and its pictures' places. A shard is a JSON file in the frame's
folder. A merge reads one shard at a time, in the order of the folders' names, and writes its file from front to back,
so memory holds one frame. The file appears under its name when it is complete.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import OutputError, RecipeError, output_error, writing
from forestgen.dataset.files import write_bytes
from forestgen.dataset.safe_path import SafePath, load_json
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import DATASET_FORMATS, PROJECTIONS
from forestgen.render.frame import Identity
from forestgen.scene.projection import Projection, load_projection

if TYPE_CHECKING:
    from forestgen.dataset.check.frame_data import FrameCheck
    from forestgen.dataset.check.merged import DatasetCheck, Merged

_REMEDY = "a worker may have stopped early: make this frame again"


class DatasetFormat:
    """A format: what it writes, what it needs, how it is checked. Each method does nothing unless it is overridden.

    A format has no state. It is used in many processes, which find it by its name in the registry.
    """

    name: str  # that recipes use: the registry's
    bytes_per_pixel: int = 0  # upper estimate of what a frame's files and its share of the merged ones take on the disk
    bytes_per_plant: int = 0  # of each plant in view, the same
    label_channels: Mapping[str, str] = {}  # of labels.channels, those that it needs -> why
    check_module: str | None = None  # with FRAME_CHECKS, DATASET_CHECKS, frame_shares: imported by verify
    split_file_names: tuple[str, ...] = ()  # all names that `split_files` may have

    def check(self, drawn: DrawnRecipe) -> None:
        """Refuse a recipe that the format cannot hold, with a `RecipeError`, before anything is simulated.

        A label channel is missing, or the format does not hold a camera's projection.
        """
        recipe = drawn.recipe
        for channel, why in self.label_channels.items():
            if channel not in recipe.labels.channels:
                keys = ("labels", "channels")
                expected = f"{channel} among labels.channels"
                got = drawn.drawn_from(", ".join(recipe.labels.channels) or "none", *keys)
                hint = f"labels: {{channels: [..., {channel}]}}, or leave {self.name} out of dataset.formats"
                raise RecipeError(why, where=drawn.where(*keys), expected=expected, got=got, hint=hint)
        for index, camera in enumerate(recipe.cameras):
            where = drawn.where("cameras", index, "kind")
            if not self.holds(load_projection(camera.kind, where=where)):
                kinds = [name for name, part in PROJECTIONS.parts() if self.holds(part)]
                expected = f"a kind that the format {self.name} can hold: {', '.join(kinds)}"
                got = drawn.drawn_from(camera.kind, "cameras", index, "kind")
                hint = f"leave {self.name} out of dataset.formats, or the camera out of this recipe"
                raise RecipeError(f"{self.name} has no such camera", where=where, expected=expected, got=got, hint=hint)

    def holds(self, projection: Projection) -> bool:
        """Whether the format has words for cameras of a projection."""
        return True

    def check_ids(self, plant_id: NDArray[np.uint32], where: str) -> None:
        """Refuse plant ids (H, W, S) of the samples that the format cannot hold, before the light is traced.

        An id that would be written and does not fit raises `OutputError` with `where`, the camera's name.
        """

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's share, the shard, into its folder, where no other format has a file of the same name.

        What cannot be written, or cannot be held, raises `OutputError`.
        """

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Write a split's files over all of its frames, and place frames' pictures elsewhere (`shards.place`).

        Of a frame's files, those that end in .json or .txt may be read; all others may be placed only, for frames of
        an object store stay there. A share that is missing, damaged, or of other species or classes, and a file that
        cannot be written, raise `OutputError`.

        Parameters
        ----------
        root : the split's folder.
        folders : the frames' folders or their names, in any order.
        """

    def split_files(self, splits: Sequence[str], settings: DatasetSettings) -> dict[str, bytes]:
        """Files beside the splits' folders, name -> content, of a data set of these splits."""
        return {}

    def frame_checks(self) -> tuple[FrameCheck, ...]:
        """What `forestgen verify` checks of each frame that has the format's files."""
        return cast("tuple[FrameCheck, ...]", getattr(self._checks(), "FRAME_CHECKS", ()))

    def dataset_checks(self) -> tuple[DatasetCheck, ...]:
        """What `forestgen verify` checks of a split's merged files."""
        return cast("tuple[DatasetCheck, ...]", getattr(self._checks(), "DATASET_CHECKS", ()))

    def frame_shares(self, merged: Merged) -> Mapping[str, Any]:
        """Frame -> what a split's merged files hold of it, as plain values: `FrameData.shared` of its checks."""
        frame_shares = getattr(self._checks(), "frame_shares", None)
        return {} if frame_shares is None else cast("Mapping[str, Any]", frame_shares(merged))

    def _checks(self) -> Any:
        return None if self.check_module is None else import_module(self.check_module)

    def card(self) -> str:
        """How to open the format, in Markdown on one line, for the data card; empty: nothing is said."""
        return ""


def load_formats(names: Iterable[str]) -> Iterator[DatasetFormat]:
    """The formats of several names, in their order."""
    return map(DATASET_FORMATS.load, names)


def check_ids(names: Iterable[str], camera_name: str, identity: Identity) -> None:
    """Refuse ids that one of the formats cannot hold; see `DatasetFormat.check_ids`."""
    for one in load_formats(names):
        one.check_ids(identity.plant_id, camera_name)


def known_formats() -> Iterator[DatasetFormat]:
    """All formats, without other packages' that are broken."""
    return (one for _, one in DATASET_FORMATS.parts())


def json_text(content: Any) -> str:
    """JSON on one line with sorted keys; NaN and infinities, which JSON lacks, raise `ValueError`."""
    return json.dumps(content, sort_keys=True, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def finite(value: float) -> float | None:
    """The number, or None, JSON's null, where it is NaN or infinite: unknown."""
    return float(value) if math.isfinite(value) else None


def write_shard(path: Path, content: Mapping[str, Any]) -> None:
    """Write a frame's share of a format; a failure raises `OutputError`."""
    write_bytes(path, (json_text(content) + "\n").encode())


def read_shard(path: Path, types: Mapping[str, type]) -> dict[str, Any]:
    """A frame's share of a format; a file that is missing, cut short, or none of this format raises `OutputError`.

    `types` are those of the values that it must hold, by key: dict, int, list[dict], list[str].
    """
    try:
        content = load_json(read_bytes(path))
    except ValueError as error:
        raise damaged(path, str(error)) from error
    for key, kind in types.items():
        value: Any = content.get(key) if isinstance(content, dict) else None
        items = [get_origin(item) or item for item in get_args(kind)]
        is_one = isinstance(value, get_origin(kind) or kind)
        if not is_one or not all(isinstance(one, item) for item in items for one in value):
            texts = {"expected": f"{key}: {kind}", "got": json_text(content)[:80], "hint": _REMEDY}
            raise OutputError("a frame's labels are not of this format", where=str(path), **texts)
    return dict(content)


def read_bytes(path: Path) -> bytes:
    """A frame's share of a format as it is; one that is missing or cannot be read raises `OutputError`."""
    try:
        return SafePath(path.parent, path.name).read()
    except FileNotFoundError as error:
        raise OutputError("a frame lacks its share of the labels", where=str(path), hint=_REMEDY) from error
    except OSError as error:
        raise OutputError(f"cannot read: {error.strerror or error}", where=str(path), hint=_REMEDY) from error


def damaged(path: Path, got: str | None = None) -> OutputError:
    """The error of a share that is there and is no whole one."""
    return OutputError("a frame's labels are cut short or damaged", where=str(path), got=got, hint=_REMEDY)


def in_order(folders: Iterable[Path | str]) -> list[str]:
    """Names of the frames' folders, sorted, each once."""
    return sorted({Path(folder).name for folder in folders})


def numbering(settings: DatasetSettings) -> dict[str, list[str]]:
    """What numbers the categories, for a shard: the species, and the category of each where it is another."""
    species = list(settings.species_names)
    categories = [settings.category_names[index] for index in settings.species_category]
    return {"species": species} if categories == species else {"species": species, "categories": categories}


def read_frame(path: Path, types: Mapping[str, type], settings: DatasetSettings) -> dict[str, Any]:
    """As `read_shard`, of a frame whose `numbering` must be the data set's."""
    shard = read_shard(path, {**types, "species": list[str]})
    wanted = numbering(settings)
    for key, what in (("species", "species"), ("categories", "labels.classes")):
        expected, got = wanted.get(key, wanted["species"]), shard.get(key, shard["species"])
        if got != expected:
            texts = {"expected": ", ".join(expected), "got": ", ".join(map(str, got))}
            raise OutputError(f"frames of one dataset must share their {what}", where=str(path), **texts)
    return shard


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[str]]:
    """A text file to write, which takes its name when all is written; after a failure nothing is left of it."""
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("w", encoding="utf-8", newline="\n") as stream:
            yield stream
        partial.replace(path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise output_error(error, path) from error
        raise


def write_list(stream: IO[str], items: Iterable[Any]) -> None:
    """Write items as they come as a JSON list, one a line."""
    start = "["
    for item in items:
        stream.write(start + "\n" + json_text(item))
        start = ","
    stream.write("[]" if start == "[" else "\n]")


def place(source: Path, target: Path) -> None:
    """Give a file a second place: a hard link, or a copy where the file system has no links; see `OutputError`."""
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        if not source.is_file():
            raise OutputError("a frame lacks a file", where=str(source), hint=_REMEDY)
        try:
            os.link(source, target)
        except OSError:
            shutil.copyfile(source, target)
