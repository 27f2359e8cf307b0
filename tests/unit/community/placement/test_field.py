"""The fast field: its draws, its sums and its deformation against the printed algorithms and brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from forestgen.community.placement.field import DensityField, place
from forestgen.community.placement.kernels import NEUTRAL, SAMPLES, KernelTable
from support.lane_algorithms import algorithm_5_1, algorithm_5_2


def kernel(distances, values, *, in_radii=True, balanced=False):
    at = np.linspace(0.0, distances[-1], SAMPLES + 1)
    return KernelTable(np.interp(at, distances, values), float(distances[-1]), in_radii, balanced)


HARD = kernel([0, 1], [0, 0])
SOFT = kernel([0, 1, 1.2], [0, 0, 1])
WEAK = kernel([0, 0.5, 1, 3], [0.2, 0.2, 1.5, 1])
CLUSTER = kernel([0, 0.3, 0.6, 3], [0, 0, 3, 1])
METRES = kernel([0, 2.5], [0.1, 1], in_radii=False)
KERNELS = {"hard": HARD, "soft": SOFT, "weak": WEAK, "cluster": CLUSTER, "metres": METRES}

SITES = [  # rows, cols, size_m, periodic
    ((64, 64), (64.0, 64.0), True),
    ((64, 64), (64.0, 64.0), False),
    ((37, 150), (60.0, 21.0), True),
    ((150, 37), (60.0, 21.0), False),
]


def rough(shape, rng, zeros=0.3):
    f = rng.gamma(0.5, 1.0, shape)
    f[rng.random(shape) < zeros] = 0.0
    return f


def one(density, size_m, periodic, radius, table, uniform):
    field = DensityField(density, size_m, periodic=periodic)
    n = len(uniform)
    placement = place([field], np.zeros(n, int), np.broadcast_to(radius, n), [[table]], uniform)
    return field, placement


def brute(density, size_m, periodic, places, radii, table):
    """Each plant's kernel on each cell, by `KernelTable.__call__`."""
    rows, cols = density.shape
    f = density.copy()
    x, y = (np.arange(cols) + 0.5) * size_m[0] / cols, (np.arange(rows) + 0.5) * size_m[1] / rows
    for (px, py), radius in zip(places, radii, strict=True):
        dx, dy = np.abs(x - px), np.abs(y - py)
        if periodic:
            dx, dy = np.minimum(dx, size_m[0] - dx), np.minimum(dy, size_m[1] - dy)
        d = np.hypot(dx[None, :], dy[:, None])
        factor = table(d, radius)
        if table.balanced:
            near = d <= table.reach_m(radius)
            before, after = f[near].sum(), (f * factor)[near].sum()
            if after > 0:
                factor[near] *= before / after
        f *= factor
    return f


def cell_of(places, shape, size_m):
    return tuple(np.floor(places / size_m * (shape[1], shape[0])).astype(int).T[::-1])


class TestDraws:
    @pytest.mark.parametrize("periodic", [False, True])
    def test_first_draw_follows_the_density(self, periodic):
        least = 1.0
        for seed in range(20):
            rng = np.random.default_rng(seed)
            f = rough((19, 23), rng)
            places = DensityField(f, (46.0, 19.0), periodic=periodic).draw(rng.random((20_000, 2)))
            counted = np.zeros(f.shape)
            np.add.at(counted, cell_of(places, f.shape, (46.0, 19.0)), 1)
            assert counted[f == 0].sum() == 0
            least = min(least, _p_value(counted, f))
        assert least >= 0.001

    def test_a_draw_is_even_inside_its_cell(self):
        places = DensityField(np.array([[1.0, 3.0], [2.0, 0.0]]), (2.0, 2.0), periodic=False).draw(
            np.random.default_rng(3).random((20_000, 2))
        )
        for axis in (0, 1):
            counted = np.bincount((places[:, axis] % 1.0 * 10).astype(int), minlength=10)
            assert chisquare(counted).pvalue >= 0.001

    def test_the_printed_mixing_of_rows_puts_plants_where_the_density_is_zero(self):
        rng = np.random.default_rng(5)
        f = rough((19, 23), rng, zeros=0.5)
        for mixed in (False, True):
            places = algorithm_5_1(
                f.copy(),
                (23.0, 19.0),
                np.zeros(20_000),
                HARD,
                rng.random((20_000, 2)),
                periodic=False,
                mixed_rows=mixed,
            )
            counted = np.zeros(f.shape)
            np.add.at(counted, cell_of(places, f.shape, (23.0, 19.0)), 1)
            if mixed:
                assert counted[f == 0].sum() > 1000
                assert _p_value(counted * (f > 0), f) < 1e-6
            else:
                assert counted[f == 0].sum() == 0
                assert _p_value(counted, f) >= 0.001

    def test_numbers_at_the_ends_of_the_range_find_a_cell_that_is_not_zero(self):
        f = np.zeros((300, 300))
        f[7, 11], f[211, 13], f[211, 290] = 1.0, 1e-9, 1e-200
        field = DensityField(f, (0.3, 7.7), periodic=False)
        ends = np.array([0.0, 1e-300, 0.5, 1.0 - 2.0**-53])
        places = field.draw(np.array([[u, v] for u in ends for v in ends]))
        assert np.all(f[cell_of(places, f.shape, (0.3, 7.7))] > 0)

    def test_an_empty_field_refuses(self):
        with pytest.raises(ValueError, match="0 everywhere"):
            DensityField(np.zeros((3, 3)), (1.0, 1.0), periodic=True).draw(np.zeros((1, 2)))


def _p_value(counted, f):
    expected = f / f.sum() * counted.sum()
    many = expected >= 5
    return chisquare(
        np.append(counted[many], counted[~many].sum()), np.append(expected[many], counted.sum() - expected[many].sum())
    ).pvalue


class TestAgainstThePrintedAlgorithms:
    @pytest.mark.parametrize("name", KERNELS)
    @pytest.mark.parametrize("site", SITES, ids=str)
    def test_same_numbers_same_places_same_fields(self, name, site):
        shape, size_m, periodic = site
        rng = np.random.default_rng(len(name) + shape[0])
        f, uniform, radius = rough(shape, rng), rng.random((100, 2)), rng.uniform(0.4, 3.0, 100)
        fast, placement = one(f, size_m, periodic, radius, KERNELS[name], uniform)
        assert placement.placed.all()
        for algorithm in (algorithm_5_1, algorithm_5_2):
            plain = f.copy()
            places = algorithm(plain, size_m, radius, KERNELS[name], uniform, periodic=periodic)
            np.testing.assert_allclose(placement.position_m, places, atol=1e-9 * max(size_m), rtol=0)
            np.testing.assert_allclose(fast.cells, plain, rtol=1e-6, atol=0)
        assert np.any(plain != f)

    @pytest.mark.parametrize("site", SITES, ids=str)
    def test_at_every_step_rows_and_columns_are_drawn_with_the_same_probabilities(self, site):
        shape, size_m, periodic = site
        rng = np.random.default_rng(8)
        plain = rough(shape, rng)
        fast = DensityField(plain, size_m, periodic=periodic)
        for _ in range(30):
            uniform, radius = rng.random((1, 2)), rng.uniform(0.5, 4.0, 1)
            placement = place([fast], np.zeros(1, int), radius, [[CLUSTER]], uniform)
            algorithm_5_1(plain, size_m, radius, CLUSTER, uniform, periodic=periodic)
            assert placement.placed[0]
            # Numbers just inside both ends of a row's share of [0, 1) must lead to that row; so for its columns.
            rows = np.append(0.0, np.cumsum(plain.sum(axis=1))) / plain.sum()
            _leads_to(fast, rows, plain, size_m)

    def test_neutral_kernels_leave_the_field(self):
        f = rough((20, 20), np.random.default_rng(1))
        field, placement = one(f, (20.0, 20.0), True, 2.0, NEUTRAL, np.random.default_rng(2).random((50, 2)))
        assert placement.placed.all()
        assert np.array_equal(field.cells, f)


def _leads_to(fast, rows, plain, size_m):
    for i in np.flatnonzero(np.diff(rows) > 1e-6):
        columns = np.append(0.0, np.cumsum(plain[i])) / plain[i].sum()
        wide = np.flatnonzero(np.diff(columns) > 1e-6)
        j = wide[len(wide) // 2]
        uniform = [
            (rows[i + a] + s * 1e-9, columns[j + b] + t * 1e-9)
            for a, s in ((0, 1), (1, -1))
            for b, t in ((0, 1), (1, -1))
        ]
        found = cell_of(fast.draw(np.array(uniform)), plain.shape, size_m)
        assert set(zip(*map(list, found), strict=True)) == {(i, j)}


class TestDeformation:
    @given(
        rows=st.integers(1, 40),
        cols=st.integers(1, 40),
        size_m=st.tuples(st.floats(1, 50), st.floats(1, 50)),
        periodic=st.booleans(),
        balanced=st.booleans(),
        radius=st.floats(0.01, 60),
        seed=st.integers(0, 99),
    )
    @settings(max_examples=150, deadline=None)
    def test_as_brute_force_on_any_grid(self, rows, cols, size_m, periodic, balanced, radius, seed):
        rng = np.random.default_rng(seed)
        f = rough((rows, cols), rng)
        table = KernelTable(np.linspace(0.3, 2.0, SAMPLES + 1), 1.3, True, balanced)
        places, radii = rng.random((3, 2)) * size_m, radius * rng.uniform(0.5, 1, 3)
        field = DensityField(f, size_m, periodic=periodic)
        field.deform(places, radii, table)
        np.testing.assert_allclose(field.cells, brute(f, size_m, periodic, places, radii, table), rtol=1e-9)
        assert field.total == pytest.approx(field.cells.sum(), rel=1e-12, abs=0)

    def test_after_thousands_of_plants_sums_are_those_of_the_cells(self):
        rng = np.random.default_rng(4)
        n = 5000
        field, _ = one(
            rough((131, 277), rng), (277.0, 131.0), True, rng.uniform(0.2, 6, n), CLUSTER, rng.random((n, 2))
        )
        anew = DensityField(field.cells, (277.0, 131.0), periodic=True)
        uniform = rng.random((2000, 2))
        assert field.total == pytest.approx(anew.total, rel=1e-13, abs=0)
        assert np.array_equal(field.draw(uniform), anew.draw(uniform))

    def test_a_balanced_kernel_keeps_the_sum_in_reach_also_across_the_edge(self):
        rng = np.random.default_rng(6)
        f = rough((50, 60), rng)
        field = DensityField(f, (60.0, 50.0), periodic=True)
        table = kernel([0, 1, 2, 3], [0, 0, 2, 1], balanced=True)
        field.deform(np.array([[0.2, 0.3], [59.0, 30.0], [30.0, 25.0]]), np.array([5.0, 4.0, 3.0]), table)
        assert not np.allclose(field.cells, f)
        assert field.total == pytest.approx(f.sum(), rel=1e-12)
        assert np.array_equal(field.cells[f == 0], f[f == 0])

    def test_a_balanced_kernel_that_leaves_nothing_bars(self):
        table = KernelTable(np.zeros(SAMPLES + 1), 1.0, True, balanced=True)
        field = DensityField(np.ones((8, 8)), (8.0, 8.0), periodic=False)
        field.deform(np.array([[4.0, 4.0]]), np.array([2.5]), table)
        assert 0 < field.total < 64

    def test_the_order_of_plants_at_given_places_is_of_no_matter(self):
        rng = np.random.default_rng(9)
        f, places, radii = rough((30, 30), rng), rng.random((40, 2)) * 30, rng.uniform(1, 4, 40)
        fields = [DensityField(f, (30.0, 30.0), periodic=True) for _ in range(2)]
        fields[0].deform(places, radii, WEAK)
        fields[1].deform(places[::-1], radii[::-1], WEAK)
        np.testing.assert_allclose(fields[0].cells, fields[1].cells, rtol=1e-12)

    def test_what_is_read_is_apart_from_the_field(self):
        rng = np.random.default_rng(10)
        f, places = rough((17, 9), rng), rng.random((5, 2)) * (9.0, 17.0)
        field = DensityField(f, (9.0, 17.0), periodic=False)
        field.deform(places, np.ones(5), WEAK)
        deformed = field.cells
        assert not np.array_equal(deformed, f)
        assert field.total == pytest.approx(deformed.sum(), rel=1e-12)
        field.cells[0, 0] = 1e9
        np.testing.assert_array_equal(field.cells, deformed)


class TestSeveralSpecies:
    def test_as_one_plant_at_a_time_by_hand(self):
        rng = np.random.default_rng(11)
        shape, size_m, n = (40, 56), (28.0, 40.0), 300
        densities = [rough(shape, rng) for _ in range(3)]
        kernels = [
            [SOFT, WEAK, NEUTRAL],
            [CLUSTER, HARD, METRES],
            [NEUTRAL, kernel([0, 2], [0, 2], balanced=True), HARD],
        ]
        species, radius, uniform = rng.integers(0, 3, n), rng.uniform(0.3, 1.5, n), rng.random((n, 2))
        fields = [DensityField(f, size_m, periodic=True) for f in densities]
        placement = place(fields, species, radius, kernels, uniform)
        byhand = [DensityField(f, size_m, periodic=True) for f in densities]
        for k in range(n):
            at = byhand[species[k]].draw(uniform[k : k + 1])
            np.testing.assert_allclose(placement.position_m[k], at[0], atol=1e-9)
            for field, row in zip(byhand, kernels, strict=True):
                field.deform(at, radius[k : k + 1], row[species[k]])
        for a, b in zip(fields, byhand, strict=True):
            np.testing.assert_allclose(a.cells, b.cells, rtol=1e-9)

    @pytest.mark.parametrize("periodic", [False, True])
    @pytest.mark.parametrize("shape", [(90, 700), (333, 101), (40, 250)])
    def test_plants_placed_at_once_stand_where_they_would_one_by_one(self, shape, periodic):
        rng = np.random.default_rng(13)
        size_m, n = (shape[1] * 0.5, shape[0] * 0.5), 2500
        densities = [rough(shape, rng), rough(shape, rng)]
        densities[1][:, 100:] = 0.0  # soon full
        kernels = [[HARD, WEAK], [kernel([0, 2], [0, 2], balanced=True), SOFT]]
        species, radius, uniform = rng.integers(0, 2, n), rng.uniform(0.3, 0.9, n), rng.random((n, 2))
        radius[::100] *= 20.0
        fields, single = ([DensityField(f, size_m, periodic=periodic) for f in densities] for _ in range(2))
        together = place(fields, species, radius, kernels, uniform)
        for k in range(n):
            alone = place(single, species[k : k + 1], radius[k : k + 1], kernels, uniform[k : k + 1])
            assert alone.position_m.tobytes() == together.position_m[k : k + 1].tobytes()
        assert np.count_nonzero(together.placed) > 100
        for a, b in zip(fields, single, strict=True):
            assert a.cells.tobytes() == b.cells.tobytes()

    def test_fields_that_were_placed_together_go_on_apart_and_in_another_order(self):
        rng = np.random.default_rng(12)
        made = [rough((16, 16), rng) for _ in range(2)]
        uniform, species = rng.random((20, 2)), np.arange(20) % 2
        fields = [DensityField(f, (16.0, 16.0), periodic=False) for f in made]
        place(fields, species, np.ones(20), [[HARD, WEAK], [WEAK, HARD]], uniform)
        kept = fields[0].cells.copy()
        fields[1].deform(np.array([[8.0, 8.0]]), np.ones(1), CLUSTER)
        np.testing.assert_array_equal(fields[0].cells, kept)
        twice = [DensityField(f.cells, (16.0, 16.0), periodic=False) for f in fields]
        a = place(fields[::-1], species, np.ones(20), [[HARD, WEAK], [WEAK, HARD]], uniform)
        b = place(twice[::-1], species, np.ones(20), [[HARD, WEAK], [WEAK, HARD]], uniform)
        assert np.array_equal(a.position_m, b.position_m)
        assert np.array_equal(fields[0].cells, twice[0].cells)

    def test_a_species_without_a_place_is_passed_over_and_others_go_on(self):
        fields = [DensityField(f, (8.0, 8.0), periodic=False) for f in (np.zeros((8, 8)), np.ones((8, 8)))]
        species = np.arange(20) % 2
        none = [[NEUTRAL] * 2] * 2
        placement = place(fields, species, np.ones(20), none, np.random.default_rng(1).random((20, 2)))
        assert np.array_equal(placement.placed, species == 1)
        assert np.array_equal(np.isnan(placement.position_m).all(axis=1), species == 0)

    def test_a_field_too_small_for_all(self):
        f = np.zeros((32, 32))
        f[:, :16] = 1.0
        field, placement = one(f, (32.0, 32.0), True, 3.0, HARD, np.random.default_rng(2).random((500, 2)))
        count = int(placement.placed.sum())
        assert 10 < count < 60
        assert np.array_equal(placement.placed, np.arange(500) < count)
        assert field.total == 0.0
        assert np.all(field.cells == 0.0)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"table": KernelTable(np.full(SAMPLES + 1, 2e6), 1.0, True)}, "from 0 to"),
        ],
    )
    def test_what_does_not_fit_is_refused(self, change, message):
        given = {"species": [0], "radius": [1.0], "table": HARD} | change
        field = DensityField(np.ones((4, 4)), (4.0, 4.0), periodic=True)
        with pytest.raises(ValueError, match=message):
            place([field], np.array(given["species"]), np.array(given["radius"]), [[given["table"]]], np.zeros((1, 2)))

    @pytest.mark.parametrize("bad", [[[np.nan]], [[-1.0]], [[np.inf]]])
    def test_what_is_no_density_is_refused(self, bad):
        with pytest.raises(ValueError, match="densit"):
            DensityField(np.array(bad), (1.0, 1.0), periodic=True)


class TestExtremes:
    @pytest.mark.parametrize("shape", [(1, 1), (1, 200), (200, 1), (2, 3)])
    @pytest.mark.parametrize("periodic", [False, True])
    def test_small_fields_and_a_reach_beyond_the_site(self, shape, periodic):
        rng = np.random.default_rng(1)
        f = rng.random(shape) + 0.1
        uniform, size_m = rng.random((30, 2)), (3.0, 2.0)
        field, placement = one(f, size_m, periodic, 4.0, WEAK, uniform)
        expected = brute(f, size_m, periodic, placement.position_m, np.full(30, 4.0), WEAK)
        np.testing.assert_allclose(field.cells, expected, rtol=1e-9)
        assert np.all((placement.position_m > 0) & (placement.position_m < size_m))

    @pytest.mark.parametrize("radius", [0.0, 1e-300, 1e-9])
    def test_plants_of_no_size_place_and_bar_nothing_else(self, radius):
        field, placement = one(
            np.ones((9, 9)), (9.0, 9.0), True, radius, HARD, np.random.default_rng(1).random((99, 2))
        )
        assert placement.placed.all()
        assert np.all(field.cells == 1.0)

    @pytest.mark.parametrize("value", [1e-6, 1e6])
    @pytest.mark.parametrize("balanced", [False, True])
    def test_strong_kernels_again_and_again(self, value, balanced):
        table = KernelTable(np.linspace(value, 1.0, SAMPLES + 1), 2.0, True, balanced)
        field, placement = one(
            np.ones((24, 24)), (24.0, 24.0), True, 9.0, table, np.random.default_rng(3).random((3000, 2))
        )
        assert placement.placed.all()
        assert np.all(np.isfinite(field.cells))
        assert 0 < field.total < 1e256
        assert field.total == pytest.approx(field.cells.sum(), rel=1e-12)
        if not balanced:
            assert field.exponent != 0

    def test_scaling_by_powers_of_two_keeps_the_proportions(self):
        f = rough((20, 20), np.random.default_rng(5), zeros=0.0) + 0.5
        field = DensityField(f, (20.0, 20.0), periodic=False)
        even = KernelTable(np.full(SAMPLES + 1, 1e6), 10.0, True)
        field.deform(np.full((100, 2), 10.0), np.full(100, 5.0), even)
        assert field.exponent + np.log2(field.total / f.sum()) == pytest.approx(100 * np.log2(1e6), rel=1e-9)
        np.testing.assert_allclose(field.cells / field.total, f / f.sum(), rtol=1e-12)

    @pytest.mark.parametrize("scale", [5e-324, 1e-300, 1e-120, 1e250, 1e300])
    def test_densities_near_the_ends_of_what_numbers_can_say(self, scale):
        f = np.array([[1.0, 2.0], [0.0, 5.0]]) * scale
        field = DensityField(f, (2.0, 2.0), periodic=False)
        np.testing.assert_array_equal(np.ldexp(field.cells, field.exponent), f)
        usual = DensityField(f / scale, (2.0, 2.0), periodic=False)
        uniform = np.random.default_rng(1).random((50, 2))
        np.testing.assert_allclose(field.draw(uniform), usual.draw(uniform), atol=1e-12)

    def test_masks_with_hard_cores_are_never_entered(self):
        rng = np.random.default_rng(7)
        f = rough((97, 101), rng, zeros=0.6)
        n, size_m, radius = 2000, (10.1, 9.7), 0.17
        _, placement = one(f, size_m, True, radius, HARD, rng.random((n, 2)))
        places = placement.position_m[placement.placed]
        assert 200 < len(places) < n
        cells = cell_of(places, f.shape, size_m)
        assert np.all(f[cells] > 0)
        middle = (np.stack(cells[::-1], axis=1) + 0.5) * 0.1
        for k in range(1, len(places)):  # the middle of a later plant's cell lies outside of all earlier cores
            d = np.abs(middle[k] - places[:k])
            d = np.minimum(d, np.array(size_m) - d)
            assert np.hypot(*d.T).min() > radius - 1e-9

    def test_same_input_same_bytes(self):
        uniform = np.random.default_rng(1).random((500, 2))
        a, b = (one(np.ones((64, 64)), (64.0, 64.0), True, 1.5, SOFT, uniform) for _ in range(2))
        assert a[1].position_m.tobytes() == b[1].position_m.tobytes()
        assert a[0].cells.tobytes() == b[0].cells.tobytes()
