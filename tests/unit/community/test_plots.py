from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from forestgen.community.model import Site, simulate
from forestgen.community.models.multiset_lsystem import MODEL
from forestgen.community.plots import CONIFER, plot_curves, plot_map
from forestgen.core.errors import OutputError


@pytest.fixture
def history(tree, site):
    return list(simulate(MODEL, MODEL.Parameters(), site, [tree(), tree(name="b")], 3, steps=30))


def test_a_map_is_a_picture_without_date(history, site, tmp_path):
    for name in ("a.png", "b.png"):
        plot_map(history[-1], site, {"tree": CONIFER}, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with Image.open(tmp_path / "a.png") as image:
        assert not {"Date", "Creation Time", "Software"} & set(image.info)
        assert image.size[0] > 800


def test_a_map_shows_more_colour_where_plants_stand(history, site, tmp_path):
    plot_map(history[0], site, {}, tmp_path / "empty.png")
    plot_map(history[-1], site, {"tree": CONIFER, "b": CONIFER}, tmp_path / "full.png")
    with Image.open(tmp_path / "empty.png") as empty, Image.open(tmp_path / "full.png") as full:
        assert empty.size == full.size
        changed = np.any(np.array(empty.convert("RGB")) != np.array(full.convert("RGB")), axis=2)
    assert changed.mean() > 0.05


@pytest.mark.parametrize("size", [(1000.0, 10.0), (10.0, 1000.0), (0.5, 0.5)])
def test_maps_of_odd_sites(history, size, tmp_path):
    plot_map(history[-1], Site(size), {}, tmp_path / "a.png", periodic=False)
    assert (tmp_path / "a.png").stat().st_size > 0


def test_curves(history, site, tmp_path):
    plot_curves(history, site, {"tree": CONIFER}, tmp_path / "a.png")
    plot_curves(history[:1], site, {}, tmp_path / "b.png")
    assert (tmp_path / "a.png").stat().st_size > 0
    with pytest.raises(ValueError, match="at least one"):
        plot_curves([], site, {}, tmp_path / "c.png")


def test_a_folder_that_is_not_there(history, site, tmp_path):
    with pytest.raises(OutputError, match="nowhere"):
        plot_map(history[-1], site, {}, tmp_path / "nowhere" / "a.png")


def test_matplotlib_comes_late_and_pyplot_never():
    code = (
        "import sys, forestgen.community.plots as p; assert 'matplotlib' not in sys.modules; p._figure(1, 1);"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
