"""Calls into the renderer that Ctrl-C can stop."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RenderError
from forestgen.render.variant import SCALAR, mitsuba


@contextmanager
def renderer_errors() -> Iterator[None]:
    """The renderer's and Dr.Jit's own errors as `RenderError`, and as `MemoryError` where they ran out of memory."""
    try:
        yield
    except RuntimeError as error:
        if "out of memory" in str(error).lower():
            raise MemoryError(str(error)) from error
        raise RenderError(f"Mitsuba stopped: {error}") from error


def interruptible(integrator: Any, scene: Any, sensor: Any, seed: int, samples: int) -> NDArray[np.float32]:
    """(H, W, C) image of the scalar variant; Ctrl-C stops the rendering within a fraction of a second.

    Raises
    ------
    RenderError : the renderer failed.
    MemoryError : it ran out of memory.
    """
    mi = mitsuba()
    result: list[NDArray[np.float32]] = []
    failure: list[BaseException] = []

    def work() -> None:
        try:
            mi.set_variant(SCALAR)
            result.append(np.array(integrator.render(scene, sensor=sensor, seed=seed, spp=samples)))
        except BaseException as error:  # noqa: BLE001 - handed to the waiting thread, which raises it
            failure.append(error)

    thread = threading.Thread(target=work, name="forestgen-render")
    thread.start()
    try:
        while thread.is_alive():
            thread.join(0.05)
    except BaseException:
        integrator.cancel()
        thread.join()
        raise
    if failure and isinstance(failure[0], MemoryError):
        raise failure[0]
    if failure:
        raise RenderError(f"Mitsuba stopped: {failure[0]}") from failure[0]
    return result[0]
