"""A frame as Python sees it: arrays, the plants' table, the camera. The same class made just now or read from a file.

Arrays are (H, W) or (H, W, C), row 0 at the top. What a recipe's `labels.channels` leaves out is None.

| attribute            | type             | meaning |
|----------------------|------------------|-----------------------------------------------------------------------|
| radiance             | (H, W, C) f32    | linear Rec. 709 in cd/m2, or W m-2 sr-1 nm-1 in each of `channels` |
| variance, denoised   | (H, W, C) f32    | variance of `radiance`; its denoised copy, which is biased, or None |
| instance             | (H, W) uint32    | plant_id; 0 is no plant |
| semantic, part       | (H, W) uint8     | numbers of `classes`, and of `parts` |
| depth, distance      | (H, W) f32       | metres along the camera's axis, and along the ray; infinite for the s |
| position, normal     | (H, W, 3) f32    | metres, world; unit, world; NaN and 0 for the sky |
| albedo               | (H, W, 3) f32    | reflectance + transmittance |
| sun, cloud, boundary | (H, W)           | sun visible; opacity of the clouds; borders of what hides something |
| motion               | (H, W, 2) f32    | pixels right and down to the sequence's next frame; NaN: none |
| preview, overlay     | (H, W, 3) uint8  | sRGB picture; the same with the plants tinted |
| plants               | pyarrow.Table    | a row a plant, see `forestgen.dataset.tables` |
| camera               | dict             | see `forestgen.dataset.camera` |
| info                 | dict             | the frame's row of the index, see `forestgen.dataset.index` |

`channel("normal.camera", "X")` is any other channel of frame.exr, of which `forestgen.dataset.exr` has a table.
"""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.arguments import flag_of, path_of
from forestgen.core.errors import OutputError, RecipeError
from forestgen.dataset.files import make_folder, write_bytes
from forestgen.dataset.png import instance_of, overlay, rgb_of, semantic_of
from forestgen.dataset.safe_path import SafePath, read_object, read_parquet, reading
from forestgen.recipe.assets import MAPS

Parts = Mapping[str, Mapping[str, NDArray[Any]]]


class Frame(ABC):
    """See the module."""

    def __init__(self, info: Mapping[str, Any], classes: tuple[str, ...]) -> None:
        self._info, self._classes = info, classes

    @property
    def name(self) -> str:
        """Of its folder, such as ``000000-camera0``."""
        return str(self._info["frame"])

    @property
    def info(self) -> Mapping[str, Any]:
        return self._info

    @property
    def image(self) -> int:
        """Number of the image that it belongs to."""
        return int(self.info["image"])

    @property
    def split(self) -> str:
        """Such as ``train``."""
        return str(self.info["split"])

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the semantic classes, by number."""
        return self._classes

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the radiance's channels."""
        return tuple(self.info["channels"])

    @property
    @abstractmethod
    def recipe(self) -> str:
        """The drawn recipe as YAML: rendered again it gives this image. `forestgen.load` reads the frame itself."""

    @property
    @abstractmethod
    def recipe_folder(self) -> Path:
        """What the paths of maps and other files in `recipe` are relative to."""

    @property
    @abstractmethod
    def parts(self) -> Parts:
        """Part of frame.exr -> channel -> (H, W) array."""

    @property
    @abstractmethod
    def plants(self) -> Any: ...

    @property
    @abstractmethod
    def camera(self) -> dict[str, Any]: ...

    @cached_property
    def radiance(self) -> NDArray[np.float32]:
        return self._stack("radiance", self.channels)

    @cached_property
    def variance(self) -> NDArray[np.float32]:
        return self._stack("radiance.variance", self.channels)

    @cached_property
    def denoised(self) -> NDArray[np.float32] | None:
        return self._stack("radiance.denoised", self.channels) if "radiance.denoised" in self.parts else None

    @property
    @abstractmethod
    def instance(self) -> NDArray[np.uint32]: ...

    @property
    @abstractmethod
    def semantic(self) -> NDArray[np.uint8]: ...

    @cached_property
    def part(self) -> NDArray[np.uint8]:
        return self.channel("identity", "part").astype(np.uint8)

    @property
    def depth(self) -> NDArray[np.float32]:
        return self.channel("depth", "Z")

    @property
    def distance(self) -> NDArray[np.float32]:
        return self.channel("depth", "distance")

    @cached_property
    def position(self) -> NDArray[np.float32] | None:
        return self._optional("position", "XYZ")

    @cached_property
    def normal(self) -> NDArray[np.float32] | None:
        return self._optional("normal", "XYZ")

    @cached_property
    def albedo(self) -> NDArray[np.float32] | None:
        return self._optional("albedo", "RGB")

    @cached_property
    def motion(self) -> NDArray[np.float32] | None:
        return self._optional("motion", ("forward.u", "forward.v"))

    @cached_property
    def sun(self) -> NDArray[np.bool_] | None:
        return self.channel("sun", "visible").astype(bool) if "sun" in self.parts else None

    @property
    def cloud(self) -> NDArray[np.float32] | None:
        return self.channel("cloud", "opacity") if "cloud" in self.parts else None

    @cached_property
    def boundary(self) -> NDArray[np.bool_] | None:
        return self.channel("boundary", "occluding").astype(bool) if "boundary" in self.parts else None

    @property
    @abstractmethod
    def preview(self) -> NDArray[np.uint8]: ...

    @cached_property
    def overlay(self) -> NDArray[np.uint8]:
        return overlay(self.preview, self.instance)

    def channel(self, part: str, name: str) -> NDArray[Any]:
        """(H, W) array of a channel of frame.exr.

        Raises
        ------
        RecipeError : the frame has no such channel.
        """
        try:
            return self.parts[part][name]
        except (KeyError, TypeError):
            known = ", ".join(f"{one} ({', '.join(self.parts[one])})" for one in self.parts)
            raise RecipeError(
                "the frame has no such channel", where=self.name, expected=f"one of {known}", got=f"{part}, {name}"
            ) from None

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the frame's files into a new folder of its name below `folder`; that folder's path.

        Parameters
        ----------
        overwrite : replace the folder if it holds a frame; it is the old one or the new one, and never a mixture.

        Raises
        ------
        OutputError : the folder is there already, or cannot be written.
        """
        from forestgen.dataset.folder import OutputFolder

        target = path_of(folder, "folder", output=True) / self.name
        if not flag_of(overwrite, "overwrite") and _is_frame_folder(target):
            hint = "choose another folder, or `overwrite=True`"
            raise OutputError("the frame is there already", where=str(target), hint=hint)
        with OutputFolder(target, overwrite=overwrite, is_ours=_is_frame_folder) as staging:
            self._write(staging, target.parent)
        return target

    @abstractmethod
    def _write(self, folder: Path, beside: Path) -> None:
        """Write the frame's files into `folder`, and maps that its recipe names into ``maps/`` of `beside`."""

    def show(self) -> Any:
        """A matplotlib figure: the picture, and the masks over it."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(12, 12 * self.preview.shape[0] / self.preview.shape[1] / 2), layout="constrained")
        for axes, picture in zip(figure.subplots(1, 2), (self.preview, self.overlay), strict=True):
            axes.imshow(picture)
            axes.set_axis_off()
        return figure

    def _repr_png_(self) -> bytes:
        from PIL import Image

        buffer = io.BytesIO()
        Image.fromarray(self.preview).save(buffer, format="PNG")
        return buffer.getvalue()

    def __repr__(self) -> str:
        width, height = self.info["width_px"], self.info["height_px"]
        return f"<Frame {self.name}: {width} x {height} px, {self.info['plants_in_view']} plants in view>"

    def _stack(self, part: str, names: str | tuple[str, ...]) -> NDArray[np.float32]:
        return np.stack([self.channel(part, name) for name in names], axis=-1)

    def _optional(self, part: str, names: str | tuple[str, ...]) -> NDArray[np.float32] | None:
        return self._stack(part, names) if part in self.parts else None


def _is_frame_folder(folder: Path) -> bool:
    """Whether a folder holds a frame: only such a one may be replaced by another."""
    return all(SafePath(folder, name).is_file() for name in ("frame.exr", "camera.json", "recipe.yaml"))


class StoredFrame(Frame):
    """The files of a frame's folder, each read when it is asked for."""

    def __init__(self, folder: SafePath, info: Mapping[str, Any], classes: tuple[str, ...]) -> None:
        super().__init__(info, classes)
        self._folder = folder

    @property
    def _size_px(self) -> tuple[int, int]:
        return int(self.info["width_px"]), int(self.info["height_px"])

    @cached_property
    def parts(self) -> Parts:
        from forestgen.dataset.exr_chunks import read_whole

        with reading(self._folder / "frame.exr") as path:
            return read_whole(path, unpack=False)[0]

    @cached_property
    def instance(self) -> NDArray[np.uint32]:
        with reading(self._folder / "instance.png") as path:
            return instance_of(path.read(), self._size_px)

    @cached_property
    def semantic(self) -> NDArray[np.uint8]:
        with reading(self._folder / "semantic.png") as path:
            return semantic_of(path.read(), self._size_px)

    @cached_property
    def plants(self) -> Any:
        with reading(self._folder / "plants.parquet") as path:
            return read_parquet(path)

    @cached_property
    def camera(self) -> dict[str, Any]:
        return read_object(self._folder / "camera.json")

    @cached_property
    def preview(self) -> NDArray[np.uint8]:
        with reading(self._folder / "preview.png") as path:
            return rgb_of(path.read(), self._size_px)

    @property
    def recipe(self) -> str:
        with reading(self._folder / "recipe.yaml") as path:
            return path.read().decode()

    @property
    def recipe_folder(self) -> Path:
        with reading(self._folder / "recipe.yaml") as path:
            return path.located().parent

    def _write(self, folder: Path, beside: Path) -> None:
        maps, recipe = SafePath(self._folder.root, f"{self.info['split']}/{MAPS}"), self.recipe
        self._copy(self._folder, folder)
        for name in maps.names():
            if name in recipe:
                make_folder(beside / MAPS)
                with reading(maps / name) as path:
                    write_bytes(beside / MAPS / name, path.read())

    def _copy(self, source: SafePath, target: Path) -> None:
        """All files of a folder; the folders in it are those of some formats."""
        make_folder(target)
        for name in source.names():
            if (source / name).is_folder():
                self._copy(source / name, target / name)
                continue
            with reading(source / name) as path:
                write_bytes(target / name, path.read())
