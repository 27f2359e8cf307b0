"""How often calls that are given the plan, or the built scene, return to a file that they had left.

    uv run python benchmarks/plan_calls.py

Counted while `forestgen render` makes a small quickstart in this process: the files of the functions that get an object
of the class as an argument, in the order of the calls, neighbours counted once.
"""

from __future__ import annotations

import sys
import tempfile
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Any

import forestgen
from forestgen.cli import app

PACKAGE = Path(forestgen.__file__).parent
CLASSES = ("Plan", "BuiltScene")
SMALL = ("site.size_m=[20,20]", "cameras.0.size_px=[32,18]", "render.samples=1", "render.denoise=false")
files: dict[str, list[str]] = {name: [] for name in CLASSES}


def note(frame: FrameType, event: str, _: Any) -> None:
    """Note the file of a call into the package that is given such an object."""
    code = frame.f_code
    if event != "call" or not code.co_filename.startswith(str(PACKAGE)):
        return
    arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    given = {type(frame.f_locals.get(name)).__name__ for name in arguments if name != "self"}
    for name in given & set(CLASSES):
        files[name].append(str(Path(code.co_filename).relative_to(PACKAGE)))


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        settings = [word for one in SMALL for word in ("--set", one)]
        sys.setprofile(note)
        try:
            app(["render", "recipes/quickstart.yaml", *settings, "--out", f"{folder}/out", "--quiet"])
        except SystemExit as stopped:
            if stopped.code:
                raise
        finally:
            sys.setprofile(None)
    for name, calls in files.items():
        visits = [file for file, _ in groupby(calls)]
        distinct = sorted(set(visits))
        print(f"{name}: {len(calls)} calls, {len(distinct)} files, {len(visits) - len(distinct)} returns: {distinct}")


if __name__ == "__main__":
    main()
