"""What a data set format is, and how one is found by its name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    from forestgen.dataset.check.check import DatasetCheck, FrameCheck


class DatasetFormat:
    """A format: what it writes, what it needs, how it is checked. Each method does nothing unless it is overridden.

    A format has no state. It is used in many processes, which find it by its name in the registry.
    """

    name: str  # that recipes use: the registry's
    bytes_per_pixel: int = 0  # upper estimate of what a frame's files and its share of the merged ones take on the disk
    bytes_per_plant: int = 0  # of each plant in view, the same
    label_channels: Mapping[str, str] = {}  # of labels.channels, those that it needs -> why
    check_module: str | None = None  # with FRAME_CHECKS and DATASET_CHECKS, imported when a data set is verified
    split_file_names: tuple[str, ...] = ()  # all names that `split_files` may have

    def check(self, drawn: DrawnRecipe) -> None:
        """Refuse a recipe that the format cannot hold, before anything is simulated.

        Raises
        ------
        RecipeError : with the key's place; a label channel is missing, or it does not hold a camera's projection.
        """
        recipe = drawn.recipe
        for channel, why in self.label_channels.items():
            if channel not in recipe.labels.channels:
                keys = ("labels", "channels")
                raise RecipeError(
                    why,
                    where=drawn.where(*keys),
                    expected=f"{channel} among labels.channels",
                    got=drawn.drawn_from(", ".join(recipe.labels.channels) or "none", *keys),
                    hint=f"labels: {{channels: [..., {channel}]}}, or leave {self.name} out of dataset.formats",
                )
        for index, camera in enumerate(recipe.cameras):
            where = drawn.where("cameras", index, "kind")
            if not self.holds(load_projection(camera.kind, where=where)):
                kinds = [name for name, part in PROJECTIONS.parts() if self.holds(part)]
                raise RecipeError(
                    f"{self.name} has no such camera",
                    where=where,
                    expected=f"a kind that the format {self.name} can hold: {', '.join(kinds)}",
                    got=drawn.drawn_from(camera.kind, "cameras", index, "kind"),
                    hint=f"leave {self.name} out of dataset.formats, or the camera out of this recipe",
                )

    def holds(self, projection: Projection) -> bool:
        """Whether the format has words for cameras of a projection."""
        return True

    def check_ids(self, plant_id: NDArray[np.uint32], where: str) -> None:
        """Refuse plant ids that the format cannot hold, before the light is traced.

        Parameters
        ----------
        plant_id : (H, W, S) of each sample of each pixel; 0: no plant.
        where : name of the camera, for the error.

        Raises
        ------
        OutputError : an id that would be written does not fit.
        """

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's share, the shard, into its folder, where no other format has a file of the same name.

        Raises
        ------
        OutputError : what cannot be written, or cannot be held.
        """

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Write a split's files over all of its frames, and place frames' pictures elsewhere (`shards.place`).

        Of a frame's files, those that end in .json or .txt may be read; all others may be placed only, for frames of
        an object store stay there.

        Parameters
        ----------
        root : the split's folder.
        folders : the frames' folders or their names, in any order.

        Raises
        ------
        OutputError : a share is missing or damaged, or a file cannot be written.
        """

    def split_files(self, splits: Sequence[str], settings: DatasetSettings) -> dict[str, bytes]:
        """Files beside the splits' folders, name -> content, of a data set of these splits."""
        return {}

    def frame_checks(self) -> tuple[FrameCheck, ...]:
        """What `forestgen verify` checks of each frame that has the format's files."""
        checks: tuple[FrameCheck, ...] = self._checks("FRAME_CHECKS")
        return checks

    def dataset_checks(self) -> tuple[DatasetCheck, ...]:
        """What `forestgen verify` checks of a split's merged files."""
        checks: tuple[DatasetCheck, ...] = self._checks("DATASET_CHECKS")
        return checks

    def _checks(self, name: str) -> Any:
        return () if self.check_module is None else getattr(import_module(self.check_module), name, ())

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
