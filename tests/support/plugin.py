"""The package of examples/plugin, installed into a folder."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

PLUGIN = Path(__file__).parents[2] / "examples" / "plugin"


def install_plugin(folder: Path) -> Path:
    """A folder for Python's path with the installed package; what builds it is in uv's cache since forestgen was."""
    if shutil.which("uv") is None:
        pytest.skip("needs uv to install")
    source, target = shutil.copytree(PLUGIN, folder / "plugin_source"), folder / "packages"
    command = ("uv", "pip", "install", "--offline", "--no-deps", "--quiet", "--target", target, source)
    subprocess.run(command, check=True, timeout=120)
    return target
