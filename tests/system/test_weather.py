"""forestgen weather: numbers, files and pictures of a simulated sky, and its mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import run, tiny

import forestgen as fg
from support.error_messages import raises_error

FOG = "sky: {clouds: {type: fog, time_s: 600, domain: {extent_m: 400, cell_m: 50, cell_height_m: 20}}}"


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORESTGEN_CACHE", str(tmp_path / "cache"))


def test_a_sky_in_numbers_files_and_a_picture(tmp_path: Path) -> None:
    from PIL import Image

    from forestgen.atmosphere.weather_files import read_sky

    recipe = tiny(tmp_path, ("seed: 3", FOG))
    air, volume, picture = tmp_path / "a" / "sky.nc", tmp_path / "sky.vol", tmp_path / "sky.png"
    answer = run("weather", recipe, "--out", air, "--out", volume, "--picture", picture)
    assert answer.code == 0
    weather, grid = read_sky(air), read_sky(volume)
    assert weather.time_s == 600.0
    assert weather.cloud.shape == (8, 8, 8)
    assert np.isfinite(grid.extinction_per_m).all()
    columns = answer.out.splitlines()[2].split()
    assert columns[:3] == ["0", "fog", "600"]
    assert int(columns[3]) == round(100 * float((weather.cloud >= 1e-5).any(axis=0).mean()))
    with Image.open(picture) as image:
        assert np.asarray(image.convert("RGB")).std() > 10
    run("weather", recipe, "--out", air).refused(4)


def test_of_many_images_the_last_air_alone_is_kept(tmp_path: Path) -> None:
    first, last = fg.load(tiny(tmp_path, ("seed: 3", FOG))).weather(2, progress=False)
    assert first.weather is None
    assert last.weather is not None
    assert first.statistics.time_s == last.statistics.time_s == 600.0


def test_files_appear_together_or_not_at_all(tmp_path: Path) -> None:
    recipe = fg.load(tiny(tmp_path, ("seed: 3", FOG)), set={"sky.clouds.time_s": 0})
    air, volume, picture = tmp_path / "new" / "sky.nc", tmp_path / "new" / "sky.vdb", tmp_path / "new" / "sky.png"
    with raises_error(fg.OutputError, place="sky.vdb") as refused:
        recipe.weather(out=[air, volume], picture=picture, progress=False)
    assert refused.value.place == str(volume)
    assert not air.parent.exists()


def test_its_mistakes_are_told(tmp_path: Path) -> None:
    recipe = tiny(tmp_path, ("seed: 3", FOG))
    run("weather", recipe, "--out", tmp_path / "sky.txt").refused(2)
    run("weather", recipe, "--picture", tmp_path / "sky.jpg").refused(2)
    run("weather", recipe, "--set", "sky.clouds=noise").refused(2)
    run("weather", recipe, "--set", "sky.clouds.domain.extent_m=100", "--set", "site.size_m=[300, 300]").refused(2)
