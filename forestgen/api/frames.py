"""Frames in memory: what `Recipe.frames` yields."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Timings
from forestgen.core.threads import cores, limit_cores
from forestgen.dataset.camera import camera_model
from forestgen.dataset.exr import frame_parts
from forestgen.dataset.frame import Frame, Parts
from forestgen.dataset.settings import DatasetSettings, data_set_of
from forestgen.dataset.tables import plants_table
from forestgen.dataset.tonemap import preview_of
from forestgen.dataset.writer import write_frame, write_maps
from forestgen.pipeline import RenderedFrame, assemble_image, image_frames
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe, dump_yaml
from forestgen.render.variant import mitsuba, tracing_on
from forestgen.runs.summary import Display
from forestgen.scene.plan import check_memory, make_plan


class MadeFrame(Frame):
    """A frame that was just rendered."""

    def __init__(self, frame: RenderedFrame, drawn: DrawnRecipe, settings: DatasetSettings) -> None:
        super().__init__(frame.row, settings.class_names)
        self._frame, self._drawn, self._settings = frame, drawn, settings

    @cached_property
    def recipe(self) -> str:
        return dump_yaml(self._drawn)

    @property
    def recipe_folder(self) -> Path:
        return self._drawn.folder

    @cached_property
    def parts(self) -> Parts:
        return frame_parts(self._frame.labelled)

    @property
    def instance(self) -> NDArray[np.uint32]:
        return self._frame.labelled.pixels.instance

    @property
    def semantic(self) -> NDArray[np.uint8]:
        return self._frame.labelled.pixels.semantic

    @cached_property
    def plants(self) -> Any:
        return plants_table(self._frame.labelled)

    @cached_property
    def camera(self) -> dict[str, Any]:
        return camera_model(self._frame.labelled.frame.camera)

    @cached_property
    def preview(self) -> NDArray[np.uint8]:
        return preview_of(self._frame.labelled.frame.radiance, self._settings.view).picture

    def _write(self, folder: Path, beside: Path) -> None:
        stored = replace(self._drawn, data=write_maps(beside, self._drawn.data, self._drawn.folder))
        write_frame(folder, self._frame.labelled, dump_yaml(stored), self._frame.attributes, self._settings)


def frames_of(
    loaded: LoadedRecipe, images: range, threads: int | None, device: str | None, display: Display
) -> Iterator[Frame]:
    """See `Recipe.frames`. Nothing is set while the caller looks at a frame."""
    for index in images:
        with _tracing(threads, device), display.running():
            plan = make_plan(loaded.draw(index))
            check_memory(plan)
            image = assemble_image(plan, display, Timings())
        made = image_frames(image, display, Timings())
        while True:
            with _tracing(threads, device), display.running():
                frame = next(made, None)
            if frame is None:
                break
            yield MadeFrame(frame, image.drawn, data_set_of(image.drawn))


@contextmanager
def _tracing(threads: int | None, device: str | None) -> Iterator[None]:
    """In the block, rays are traced by so many threads, and on a device."""
    with tracing_on(device):
        limit_cores(threads)
        mitsuba(threads)
        try:
            yield
        finally:
            if threads is not None:
                limit_cores(None)
                mitsuba(cores())
