"""Images that are not done yet: running sums kept on disk, so that work goes on where it was interrupted.

They lie in the folder `radiance` of the cache (see core/cache.py), under the hash of all that the image depends
on: the drawn recipe, the image's seed, the camera, and the code, tables and packages that make it. A sum is written
when work is interrupted, and at times while it goes on, so that a process that is killed loses little; it is removed
when the image is done. What is continued has the bytes of what was never interrupted: a replicate's seeds belong to
its number.
"""

from __future__ import annotations

import hashlib
import io
import time
import zipfile
from dataclasses import dataclass
from typing import Any

import numpy as np

from forestgen.core.cache import DiskCache, cache_root, code_hash
from forestgen.recipe.assets import scenes_dir
from forestgen.render.slices import SliceSum

EVERY_S = 20.0  # at least, from one writing to the next
_MOST_BYTES = 4_000_000_000
# Layers that shape an image.
_SOURCES = (
    "architecture", "atmosphere", "community", "core", "geometry", "lsystem", "plants", "recipe", "render",
    "scene",
)  # fmt: skip
_COMPUTE_WITH = ("numpy", "scipy", "numba", "pvlib", "mitsuba", "drjit")


@dataclass
class Unfinished:
    """The place of one image's running sum. It is used in one thread."""

    store: DiskCache
    key: str
    _written_s: float = 0.0

    def read(self) -> tuple[SliceSum, float]:
        """The sum so far and the seconds spent on it; an empty one if there is none that can be read."""
        self._written_s = time.monotonic()
        data = self.store.read(self.key)
        if data is None:
            return SliceSum(), 0.0
        try:
            with np.load(io.BytesIO(data.tobytes()), allow_pickle=False) as state:
                return SliceSum.restored(state), float(state["elapsed_s"])
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            self.store.drop(self.key)
            return SliceSum(), 0.0

    def write(self, total: SliceSum, elapsed_s: float, *, now: bool = False) -> None:
        """Keep the sum; unless it must be `now`, at most every `EVERY_S` seconds."""
        if not total.slices or not (now or time.monotonic() - self._written_s >= EVERY_S):
            return
        file = io.BytesIO()
        arrays: dict[str, Any] = {"elapsed_s": np.array(elapsed_s), **total.state()}
        np.savez(file, **arrays)
        self.store.write(self.key, file.getvalue())
        self.store.trim()
        self._written_s = time.monotonic()

    def drop(self) -> None:
        """The image is done."""
        self.store.drop(self.key)


def unfinished(*identity: str | int) -> Unfinished | None:
    """The place of an image, by all that it depends on besides the code; None if nothing can be kept here."""
    root = cache_root()
    if root is None:
        return None
    code = code_hash(_SOURCES, _COMPUTE_WITH, tuple(scenes_dir() / kind for kind in ("spectra", "modules")))
    text = repr((code, *identity))
    return Unfinished(DiskCache(root / "radiance", _MOST_BYTES), hashlib.sha256(text.encode()).hexdigest())
