"""Processes of our own that need nothing of the caller's script."""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_main() -> Iterator[None]:
    """Processes that multiprocessing spawns in this block do not run the caller's ``__main__`` again.

    It may be standard input, a notebook, or a script without a ``__main__`` guard. What is sent to such a process must
    be importable from a module.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
