"""The ground: one height for mesh, normals and feet."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.recipe.load import load_recipe_data
from forestgen.scene import terrain
from forestgen.scene.grounds import litter
from forestgen.scene.surfaces import FreshLitter, fresh_litter
from forestgen.scene.terrain import HORIZON_M, HeightField, build_terrain, terrain_mesh
from forestgen.scene.terrains.rolling import rolling

SIZE_M = (60.0, 40.0)


@pytest.fixture(scope="module")
def height():
    return rolling(SIZE_M, 1.0, 50.0, np.random.default_rng(2))


@pytest.fixture(scope="module")
def mesh(height):
    return terrain_mesh(height)


def test_vertices_lie_on_the_height_field(height, mesh):
    x, y, z = mesh.vertices_m.astype(np.float64).T
    near = (np.abs(x) < 500) & (np.abs(y) < 500)
    np.testing.assert_allclose(z[near], height(x[near], y[near]), atol=2e-4)
    assert mesh.vertices_m[:, :2].min() <= -HORIZON_M
    assert mesh.vertices_m[:, :2].max() >= HORIZON_M


def test_a_plants_foot_is_close_to_the_mesh_between_vertices(height, mesh):
    """Within 3 cm on the site: cells are 0.75 m and the shortest wave some metres."""
    corner = mesh.vertices_m[mesh.faces].astype(np.float64)
    middle = corner.mean(axis=1)
    on_site = np.all((middle[:, :2] > 0) & (middle[:, :2] < SIZE_M), axis=1)
    error = height(middle[on_site, 0], middle[on_site, 1]) - middle[on_site, 2]
    assert np.abs(error).max() < 0.03


def test_heights_on_the_mesh_are_those_of_its_triangles(height, mesh):
    corner = mesh.vertices_m[mesh.faces].astype(np.float64)
    x, y, z = np.einsum("k,nkc->cn", [0.2, 0.3, 0.5], corner[(np.abs(corner[..., :2]) < 6000).all(axis=(1, 2))])
    np.testing.assert_allclose(height.on_mesh(x, y), z, atol=2e-3)
    assert np.abs(height(x, y) - z).max() > 1.0  # the hills between its vertices


def test_normals_are_those_of_the_slope(height, mesh):
    x, y = (mesh.vertices_m[:, k].astype(np.float64) for k in range(2))
    on_site = (x > 0) & (x < SIZE_M[0]) & (y > 0) & (y < SIZE_M[1])
    x, y = x[on_site], y[on_site]
    d = 1e-4
    slope = np.stack(
        [(height(x + d, y) - height(x - d, y)) / (2 * d), (height(x, y + d) - height(x, y - d)) / (2 * d)], axis=1
    )
    expected = np.concatenate([-slope, np.ones((len(x), 1))], axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(mesh.normals[on_site], expected, atol=5e-3)  # differences over cells of 0.75 m
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


def test_faces_look_up_and_cover_the_plane_once(mesh):
    corner = mesh.vertices_m[mesh.faces].astype(np.float64)
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] / 2
    assert np.all(area > 0)
    extent = mesh.vertices_m[:, :2].max(axis=0).astype(np.float64) - mesh.vertices_m[:, :2].min(axis=0)
    assert area.sum() == pytest.approx(extent.prod(), rel=1e-5)


def test_flat_ground_is_flat():
    mesh = terrain_mesh(HeightField(SIZE_M))
    assert np.all(mesh.vertices_m[:, 2] == 0)
    np.testing.assert_allclose(mesh.normals, np.broadcast_to([0, 0, 1], mesh.normals.shape))


def test_the_stated_amplitude_is_the_sites_standard_deviation():
    deviations = []
    for seed in range(40):
        field = rolling((400.0, 400.0), 1.5, 60.0, np.random.default_rng(seed))
        x, y = np.meshgrid(np.linspace(0, 400, 80), np.linspace(0, 400, 80))
        deviations.append(field(x, y).std())
    assert np.mean(deviations) == pytest.approx(1.5, rel=0.08)


def test_hills_have_their_standard_deviation_and_power_that_falls_with_the_wave_number():
    """Real land has a two-dimensional spectrum of k^-3, and a steeper one beyond the length of slopes; no hills stand
    on the site.
    """
    side_m, cells = 7680.0, 256
    x, y = np.meshgrid(*[np.arange(cells) * side_m / cells] * 2)
    window = np.hanning(cells)[:, None] * np.hanning(cells)
    number = np.hypot(*np.meshgrid(*[np.fft.fftfreq(cells, side_m / cells)] * 2))
    band = (number > 1 / 1500) & (number < 1 / 300)
    deviations, slopes = [], []
    for seed in range(6):
        field = rolling(SIZE_M, 1.0, 50.0, np.random.default_rng(seed), 40.0)
        hills = field.hills_m * field.hills(x.ravel(), y.ravel(), np.zeros(x.size)).reshape(x.shape)
        deviations.append(hills.std())
        power = np.abs(np.fft.fft2(window * hills)) ** 2
        slopes.append(np.polyfit(np.log(number[band]), np.log(power[band]), 1)[0])
        level = rolling(SIZE_M, 1.0, 50.0, np.random.default_rng(seed), 0.0)
        np.testing.assert_array_equal(field(x[0, :3], y[0, :3]), level(x[0, :3], y[0, :3]))
    assert np.mean(deviations) == pytest.approx(40.0, rel=0.1)
    assert np.mean(slopes) == pytest.approx(-3.6, abs=0.3)


def test_the_texture_of_an_image_made_again_is_kept(monkeypatch):
    made: list[str] = []
    with_mean = terrain.with_mean
    monkeypatch.setattr(terrain, "with_mean", lambda *values: made.append("") or with_mean(*values))
    terrain._kept.clear()

    def build(ground: str, seed: int) -> tuple[np.ndarray, float]:
        rng = np.random.default_rng(seed)
        return build_terrain(HeightField((8.0, 8.0)), rng, ground).texture, rng.random()

    first, after = build("sand", 1)
    again, after_again = build("sand", 1)
    assert len(made) == 1
    assert again is first
    assert after_again == after, "the generator goes on as if the texture had been made"
    others = [build("sand", 2)[0], build("rock", 1)[0]]
    assert len(made) == 3
    assert not any(np.array_equal(first, other) for other in others)
    assert len(terrain._kept) == 1
    assert build("sand", 1)[0].tobytes() == first.tobytes()


def test_fresh_leaves_leave_the_rest_of_the_litter_as_it_was():
    def pattern(cover: float, seed: int = 1) -> np.ndarray:
        ground = litter.COVER.under(FreshLitter(cover, litter.COVER.reflectance())) if cover else litter.COVER
        return ground.pattern(np.random.default_rng(seed))

    bare, few, more = pattern(0.0), pattern(0.01), pattern(0.3)
    changed, later = ((one != bare).any(axis=2) for one in (few, more))
    assert 0.0 < changed.mean() < 0.02
    assert later.mean() < 0.3
    assert (few == more)[changed].all()  # leaves that lie there stay, others come


def test_a_kept_texture_is_of_the_same_fresh_leaves():
    """Leaves of the litter's own colour leave the mean as it is, but not the texture."""

    def texture(cover: float) -> np.ndarray:
        fresh = FreshLitter(cover, litter.COVER.reflectance())
        return build_terrain(HeightField((8.0, 8.0)), np.random.default_rng(1), "litter", fresh=fresh).texture

    assert not np.array_equal(texture(0.2), texture(0.6))


def test_leaves_that_fell_lately_lie_on_litter_in_the_colours_of_autumn():
    """Each layer of random leaves hides 1 - exp(-leaf area index); the ground's spectrum is that of both parts."""
    species = (
        load_recipe_data({"forestgen": 1, "species": {"beech": "beech"}, "community": {"model": "placed"}}, "test")
        .draw(0)
        .species
    )
    assert fresh_litter(species, {"beech": 0.0}) is None
    fresh = fresh_litter(species, {"beech": 1.0})
    assert fresh.cover == pytest.approx(1 - np.exp(-1.0))

    def floor(ground, leaves):
        return build_terrain(HeightField((8.0, 8.0)), np.random.default_rng(1), ground, fresh=leaves)

    bare, covered = floor("litter", None), floor("litter", fresh)
    at = np.array([550.0, 670.0, 860.0])
    mixed = bare.spectrum.at(at) + fresh.cover * (fresh.spectrum.at(at) - bare.spectrum.at(at))
    np.testing.assert_allclose(covered.spectrum.at(at), mixed, rtol=1e-6)
    assert covered.mean_colour[0] > 1.2 * bare.mean_colour[0]  # red: autumn leaves are bright beside old litter
    assert floor("sand", fresh).texture.tobytes() == floor("sand", None).texture.tobytes()
