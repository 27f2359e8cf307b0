"""What a data set format is, and how one is found by its name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import DATASET_FORMATS, PROJECTIONS
from forestgen.render.frame import Identity
from forestgen.scene.projection import Projection, load_projection

if TYPE_CHECKING:
    from forestgen.dataset.check.frame_data import FrameCheck
    from forestgen.dataset.check.merged import DatasetCheck, Merged


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
