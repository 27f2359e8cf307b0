"""The notebook of the documentation, from its first cell to its last."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "forest.ipynb"
# In a process of its own: the kernel's libraries warn, and warnings are errors here.
EXECUTE = """
import sys, nbformat
from nbclient import NotebookClient
notebook = nbformat.read(sys.argv[1], 4)
NotebookClient(notebook, timeout=1200, kernel_name="python3").execute()
nbformat.write(notebook, sys.argv[2])
"""


def test_the_notebook_is_kept_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert sum(len(cell.get("outputs", [])) for cell in cells) == 0


@pytest.mark.slow
def test_the_notebook_runs_and_shows_what_it_says(tmp_path: Path) -> None:
    done = tmp_path / "done.ipynb"
    environment = {name: value for name, value in os.environ.items() if name != "FORESTGEN_CACHE"}
    subprocess.run(
        [sys.executable, "-W", "ignore", "-c", EXECUTE, NOTEBOOK, done],
        cwd=tmp_path,
        env=environment,
        check=True,
        timeout=1500,
    )
    outputs = [out for cell in json.loads(done.read_text())["cells"] for out in cell.get("outputs", [])]
    pictures = sum("image/png" in out.get("data", {}) for out in outputs)
    texts = "".join("".join(out.get("text", [])) for out in outputs)
    assert pictures == 8  # two stands, heights, a frame, its masks, four frames, classes, a plant
    assert "recipe: valid" in texts
    assert "sound" in texts  # what Dataset.verify found
    assert not [out for out in outputs if out.get("name") == "stderr"]
