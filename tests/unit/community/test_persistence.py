"""Holes of point patterns."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from support.persistence import holes, total_persistence


def test_a_square_has_one_hole():
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    # Its sides close at half their length, its middle at half the diagonal.
    assert holes(square) == pytest.approx(np.array([[1.0, np.sqrt(2)]]))


def test_a_ring_is_a_hole_of_its_radius():
    angle = np.arange(100) * 2 * np.pi / 100
    diagram = holes(3 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert diagram == pytest.approx(np.array([[3 * np.sin(np.pi / 100), 3.0]]))
    assert total_persistence(diagram) == pytest.approx(3 - 3 * np.sin(np.pi / 100))


def test_a_lattice_has_a_hole_in_each_cell():
    k = np.arange(6.0)
    diagram = holes(np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 2))
    assert diagram == pytest.approx(np.tile([0.5, np.sqrt(0.5)], (25, 1)))
    assert total_persistence(diagram, 2.0) == pytest.approx(25 * (np.sqrt(0.5) - 0.5) ** 2)


@pytest.mark.parametrize("factor", [1e-3, 50.0])
def test_radii_are_lengths(factor):
    points = np.random.default_rng(0).random((200, 2))
    one, other = holes(points), holes(factor * (points + 7.0))
    assert other == pytest.approx(factor * one, rel=1e-6)
    assert np.all(np.diff(one[:, 1] - one[:, 0]) <= 0)
    assert np.all(one[:, 1] > one[:, 0])


def test_clusters_leave_longer_lived_clearings_than_cells():
    rng = np.random.default_rng(1)
    k = np.arange(20) / 20
    regular = np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 2) + rng.normal(0, 0.003, (400, 2))
    clustered = np.mod(np.repeat(rng.random((20, 2)), 20, axis=0) + rng.normal(0, 0.03, (400, 2)), 1.0)
    life = [np.ptp(holes(one)[0]) for one in (regular, rng.random((400, 2)), clustered)]
    assert life[0] < life[1] < life[2]


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.zeros((5, 2)), np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])])
def test_points_without_a_hole(points):
    assert holes(points).shape == (0, 2)
    assert total_persistence(holes(points)) == 0.0


def test_gudhi_comes_late():
    code = "import sys, support.persistence; assert 'gudhi' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
