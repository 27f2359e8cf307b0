from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from forestgen.community import history_files
from forestgen.community.history_files import Film
from forestgen.community.plot_series import plot_curves, plot_sizes, plot_thinning
from forestgen.community.plots import CONIFER, OBSTACLE, map_figure, save_figure
from forestgen.community.population import Population, Site, Status
from forestgen.community.simulation import NO_OBSTACLES, Obstacles
from forestgen.community.trajectory import Trajectory, moment, thinning_slope
from forestgen.core.errors import OutputError
from forestgen.recipe.species import Building
from support.error_messages import raises_error

NAMES = ("tree", "b")


def stand(n, step=0, *, size=(60.0, 40.0), radius_m=0.5, names=NAMES, seed=0):
    rng = np.random.default_rng(seed)
    return Population(
        time_yr=0.5 * step,
        species_names=names,
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=(np.arange(n) % len(names)).astype(np.uint16),
        position_m=np.concatenate([rng.random((n, 2)) * size, np.zeros((n, 1))], axis=1),
        radius_m=radius_m * rng.lognormal(0, 0.4, n),
        height_m=np.ones(n),
        age_yr=np.ones(n),
        status=np.zeros(n, np.uint8),
        step=step,
    )


@pytest.fixture
def history():
    return [stand(max(10, 400 - 20 * k), k, radius_m=0.2 * (400 / max(10, 400 - 20 * k)) ** 0.5) for k in range(20)]


@pytest.fixture
def trajectory(history, site):
    return Trajectory.of([moment(one, site) for one in history], NAMES, site, "m³")


def pixels(path):
    with Image.open(path) as image:
        return np.array(image.convert("RGB"))


def changed(one, other):
    """Share of the pixels that differ."""
    return np.any(pixels(one) != pixels(other), axis=2).mean()


def test_a_map_is_a_picture_without_date(history, site, tmp_path):
    for name in ("a.png", "b.png"):
        save_figure(map_figure(history[-1], site, {"tree": CONIFER}), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with Image.open(tmp_path / "a.png") as image:
        assert not {"Date", "Creation Time", "Software"} & set(image.info)
        assert image.size[0] > 800


def test_a_map_shows_more_colour_where_plants_stand(site, tmp_path):
    save_figure(map_figure(stand(0), site, {}), tmp_path / "empty.png")
    save_figure(map_figure(stand(300), site, {"tree": CONIFER, "b": CONIFER}), tmp_path / "full.png")
    assert changed(tmp_path / "empty.png", tmp_path / "full.png") > 0.05


def test_an_obstacle_is_its_grey_ground_plan(site, tmp_path):
    house = Obstacles((Building.model_validate({"kind": "house", "position_m": (20, 17.5), "size_m": (20, 15, 7)}),))
    grey = tuple(round(255 * one) for one in to_rgb(OBSTACLE))
    shares = []
    for obstacles in (NO_OBSTACLES, house):
        save_figure(map_figure(stand(0), site, {}, obstacles=obstacles), tmp_path / "map.png")
        film = Film(site, NAMES, {}, periodic=True, obstacles=obstacles)
        film.add(stand(0))
        film.write(tmp_path / "a.gif")
        shares.append([np.all(pixels(tmp_path / name) == grey, axis=2).mean() for name in ("map.png", "a.gif")])
    assert max(shares[0]) < 0.001
    assert shares[1] == pytest.approx([0.080, 0.116], rel=0.05)  # 1/8 of the site, without margins


def test_plants_without_obstacles_keep_their_species():
    population = stand(9, names=("oak", "house", "pine"))
    plants = Obstacles((Building.model_validate({"kind": "house", "position_m": (20, 17.5)}),)).left_out_of(population)
    assert plants.species_names == ("oak", "pine")
    assert plants.plant_id.tolist() == [1, 3, 4, 6, 7, 9]
    assert plants.species.tolist() == [0, 1] * 3
    assert NO_OBSTACLES.left_out_of(population) is population


@pytest.mark.parametrize("rows", [1, 2, 3, 5])
@pytest.mark.parametrize("size", [(40.0, 40.0), (60.0, 30.0), (30.0, 60.0)])
def test_a_maps_title_and_legend_are_whole(rows, size, tmp_path):
    names = tuple(f"species {k}" for k in range(3 * rows - 1))
    save_figure(map_figure(stand(60, size=size, names=names), Site(size), {}), tmp_path / "a.png")
    picture = pixels(tmp_path / "a.png")
    assert (picture[0] == 255).all()
    assert (picture[-1] == 255).all()
    inked = np.flatnonzero((picture < 128).any(axis=(1, 2)))
    assert 1 < inked[0] < 40
    assert len(picture) - 40 < inked[-1] < len(picture) - 1


@pytest.mark.parametrize("size", [(1000.0, 10.0), (10.0, 1000.0), (0.5, 0.5)])
def test_pictures_of_odd_sites(size, tmp_path):
    population, site = stand(50, size=size), Site(size)
    save_figure(map_figure(population, site, {}, periodic=False), tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 0
    for periodic in (True, False):
        film = Film(site, NAMES, {}, periodic=periodic)
        film.add(population)
        film.write(tmp_path / "a.gif")
        with Image.open(tmp_path / "a.gif") as image:
            assert max(image.size) <= 480


def test_curves(trajectory, history, site, tmp_path):
    plot_curves(trajectory, {"tree": CONIFER}, tmp_path / "a.png")
    one = Trajectory.of([moment(history[0], site)], NAMES, site, "m³")
    plot_curves(one, {}, tmp_path / "b.png")
    assert changed(tmp_path / "a.png", tmp_path / "b.png") > 0.001


def test_the_thinning_line(trajectory, tmp_path):
    slope = thinning_slope(trajectory)
    assert slope is not None
    plot_thinning(trajectory, slope, {"tree": CONIFER}, tmp_path / "with.png")
    plot_thinning(trajectory, None, {"tree": CONIFER}, tmp_path / "without.png")
    assert changed(tmp_path / "with.png", tmp_path / "without.png") > 0.001


@pytest.mark.parametrize("plants", [0, 1, pytest.param(100, marks=pytest.mark.slow)])
def test_thinning_and_sizes_of_few_or_equal_plants(plants, site, tmp_path):
    unequal = stand(plants, names=tuple("abcdefgh"))
    for one in (unequal, Population(**{**vars(stand(plants)), "radius_m": np.ones(plants)})):
        plot_sizes(one, {"tree": CONIFER}, tmp_path / "sizes.png")
        assert (tmp_path / "sizes.png").stat().st_size > 0
    trajectory = Trajectory.of([moment(one, site)], NAMES, site, "m³")
    plot_thinning(trajectory, None, {}, tmp_path / "thinning.png")
    assert (tmp_path / "thinning.png").stat().st_size > 0


@pytest.mark.slow
def test_white_petals_show_on_white_paper(tmp_path):
    """Bars of two species of which one is white, and as small beside the other as a daisy beside a spruce."""
    two = stand(300)
    radius_m = np.where(two.species == 0, 0.02, 1.0) * two.radius_m
    plot_sizes(Population(**{**vars(two), "radius_m": radius_m}), {"tree": "#FFFFFF"}, tmp_path / "white.png")
    plot_sizes(Population(**{**vars(two), "radius_m": radius_m}), {"tree": "#000000"}, tmp_path / "black.png")
    white, black = (pixels(tmp_path / name).min(axis=2) < 128 for name in ("white.png", "black.png"))
    upper_right = np.s_[80 : white.shape[0] // 2 - 60, white.shape[1] // 2 + 100 :]
    columns = np.nonzero(white[upper_right])[1]
    assert np.ptp(columns) > 0.6 * white[upper_right].shape[1]  # the small ones have their own axis
    outlined, filled = white[upper_right].sum(), black[upper_right].sum()
    assert 0.05 * filled < outlined < filled


def test_sizes_leave_out_the_dead(tmp_path):
    population = stand(300)
    dead = Population(**{**vars(population), "status": np.full(300, Status.DEAD, np.uint8)})
    plot_sizes(dead, {}, tmp_path / "dead.png")
    plot_sizes(stand(0), {}, tmp_path / "none.png")
    assert changed(tmp_path / "dead.png", tmp_path / "none.png") == 0


def one_frame(population, site, path, *, periodic=True, colours=None):
    film = Film(site, population.species_names, colours or {}, periodic=periodic)
    film.add(population)
    film.write(path)
    return pixels(path)[history_files._CAPTION_PX :]


@pytest.mark.parametrize("radius_m", [0.05, 0.3, 2.0, 6.0])
def test_circles_have_their_place_and_area(radius_m, tmp_path):
    one = stand(1, names=("tree",))
    one = Population(**{**vars(one), "position_m": np.array([[15.0, 30.0, 0.0]]), "radius_m": np.array([radius_m])})
    picture = one_frame(one, Site((60.0, 40.0)), tmp_path / "a.gif", colours={"tree": "#000000"})
    row, column = np.nonzero(np.any(picture != picture[-1, -1], axis=2))
    scale = 440 / 60
    assert column.mean() == pytest.approx(15 * scale, abs=1.5)
    assert row.mean() == pytest.approx(10 * scale, abs=1.5)  # north is up
    radius_px = max(radius_m * scale, 0.5)
    assert np.sqrt(len(row) / np.pi) == pytest.approx(radius_px, abs=1.0)


def test_circles_go_on_at_the_opposite_edge(tmp_path):
    one = stand(1, names=("tree",))
    one = Population(**{**vars(one), "position_m": np.array([[1.0, 39.0, 0.0]]), "radius_m": np.array([5.0])})
    site = Site((60.0, 40.0))
    around = one_frame(one, site, tmp_path / "a.gif", periodic=True)
    cut = one_frame(one, site, tmp_path / "b.gif", periodic=False)
    ground = around[100, 200]
    for row, column in ((2, 2), (2, -3), (-3, 2), (-3, -3)):
        assert np.any(around[row, column] != ground)
    assert np.any(cut[2, 2] != ground)
    assert np.all(cut[-3, -3] == ground)


def test_a_film_has_its_frames_and_is_the_same_each_time(history, site, tmp_path):
    for name in ("a.gif", "b.gif"):
        film = Film(site, NAMES, {"tree": CONIFER}, periodic=True)
        for one in history:
            film.add(one)
        film.write(tmp_path / name)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == len(history)
        assert image.info["loop"] == 0


def test_a_film_that_grows_too_large_drops_frames_but_the_last(history, site, tmp_path, monkeypatch):
    film = Film(site, NAMES, {}, periodic=True)
    for one in history:
        film.add(one)
    film.write(tmp_path / "all.gif")
    most = (tmp_path / "all.gif").stat().st_size // 3
    monkeypatch.setattr(history_files, "MOST_BYTES", most)
    film.write(tmp_path / "few.gif")
    assert (tmp_path / "few.gif").stat().st_size <= most
    with Image.open(tmp_path / "all.gif") as whole, Image.open(tmp_path / "few.gif") as few:
        assert 2 <= few.n_frames < whole.n_frames
        whole.seek(whole.n_frames - 1)
        few.seek(few.n_frames - 1)
        assert np.array_equal(np.array(whole.convert("RGB")), np.array(few.convert("RGB")))


def test_a_film_of_nothing(site, tmp_path):
    with pytest.raises(ValueError, match="at least one"):
        Film(site, NAMES, {}, periodic=True).write(tmp_path / "a.gif")


def test_a_folder_that_is_not_there(history, trajectory, site, tmp_path):
    nowhere = tmp_path / "nowhere" / "a.png"
    film = Film(site, NAMES, {}, periodic=True)
    film.add(history[0])
    for write in (
        lambda: save_figure(map_figure(history[-1], site, {}), nowhere),
        lambda: plot_curves(trajectory, {}, nowhere),
        lambda: plot_thinning(trajectory, None, {}, nowhere),
        lambda: plot_sizes(history[-1], {}, nowhere),
        lambda: film.write(nowhere),
    ):
        with raises_error(OutputError, place="a.png"):
            write()


def test_matplotlib_comes_late_and_pyplot_never():
    code = (
        "import sys, forestgen.community.plots as p, forestgen.community.plot_series;"
        "assert 'matplotlib' not in sys.modules; p.new_figure(1, 1);"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
