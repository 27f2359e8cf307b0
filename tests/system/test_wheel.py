"""The wheel alone, without the checkout: installed into a fresh environment, used from another folder."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import tiny

ROOT = Path(__file__).parents[2]


def _done(folder: Path, *words: str | Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONPATH")}
    done = subprocess.run(
        [str(word) for word in words], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("uv") is None, reason="needs uv to build and install")
def test_the_wheel_works_without_the_checkout(tmp_path: Path) -> None:
    _done(tmp_path, "uv", "build", "--wheel", "--quiet", "--out-dir", tmp_path / "dist", ROOT)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    _done(tmp_path, "uv", "venv", "--quiet", "--python", "3.11", tmp_path / "venv")
    python = tmp_path / "venv" / "bin" / "python"
    # The versions of the lock file, which the cache has.
    _done(
        ROOT,
        "uv",
        "export",
        "--quiet",
        "--frozen",
        "--no-dev",
        "--no-emit-project",
        "-o",
        tmp_path / "requirements.txt",
    )
    _done(tmp_path, "uv", "pip", "install", "--quiet", "--python", python, "-r", tmp_path / "requirements.txt", wheel)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    recipe = tiny(elsewhere)
    forestgen = tmp_path / "venv" / "bin" / "forestgen"

    where = _done(elsewhere, python, "-c", "import forestgen; print(forestgen.__file__)")
    assert where.startswith(str(tmp_path / "venv"))
    assert "valid" in _done(elsewhere, forestgen, "validate", recipe)
    listing = _done(elsewhere, forestgen, "models")
    for name in ("multiset_lsystem", "silhouette", "fireweed", "poplar", "spruce", "quickstart"):
        assert name in listing
    assert str(ROOT) not in listing
    assert "Parameters" in _done(elsewhere, forestgen, "models", "silhouette")
    assert "1 frame" in _done(elsewhere, forestgen, "render", recipe, "-o", "out")
    assert (elsewhere / "out" / "train" / "000000-camera0" / "frame.exr").is_file()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("uv") is None, reason="needs uv to build")
def test_what_is_published_has_sound_metadata(tmp_path: Path) -> None:
    _done(tmp_path, "uv", "build", "--quiet", "--out-dir", tmp_path / "dist", ROOT)
    files = sorted(path for path in (tmp_path / "dist").iterdir() if path.suffix in (".whl", ".gz"))
    assert [path.suffix for path in files] == [".whl", ".gz"]
    _done(tmp_path, sys.executable, "-m", "twine", "check", "--strict", *files)
