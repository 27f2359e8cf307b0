"""The likeliest kernels of a stand, where a fit begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from forestgen.community.fitting.likelihood import score
from forestgen.community.fitting.shapes import KernelShapes
from forestgen.community.fitting.simulate import field_shape
from forestgen.community.fitting.stand import MeasuredStand

ROUGHNESS = 0.7  # standard deviation that log κ's second differences between knots are expected to have
STEEPNESS = 1.5  # and its first differences
_ORDERS = 24
_PLANTS_IN_ALL = 3000  # of all orders
_CELLS_IN_REACH = 12


def likelihood_shape(stand: MeasuredStand, shapes: KernelShapes) -> tuple[int, int]:
    """Rows and columns of the grid on which likelihoods are summed, twelve cells in a kernel's reach."""
    cells = int(np.clip(round(max(stand.size_m) / shapes.reach_m * _CELLS_IN_REACH), 32, 160))
    return field_shape(stand.size_m, cells)


def roughness_penalty(shapes: KernelShapes) -> NDArray[np.float64]:
    """(P M, P M) matrix A of the penalty θ' A θ / 2 of all log κ: the squares of their differences, first and second.

    The knot at the reach counts as 0, so that kernels fade into 1.
    """
    kernels, knots = shapes.free
    first, second = (np.diff(np.eye(knots + 1), order, axis=0)[:, :knots] for order in (1, 2))
    one = first.T @ first / STEEPNESS**2 + second.T @ second / ROUGHNESS**2
    return np.asarray(np.kron(np.eye(kernels), one), dtype=np.float64)


def likeliest(stand: MeasuredStand, shapes: KernelShapes, rng: np.random.Generator) -> NDArray[np.float64]:
    """(P, M) log κ of the greatest mean log-likelihood over random orders, less the penalty.

    Where sizes give the order there is but one; rounded places are blurred anew for each.
    """
    number = int(np.clip(_PLANTS_IN_ALL // stand.n, 4, _ORDERS))
    if stand.ordered:
        number = 1 if stand.step_m == 0 else min(number, 8)
    draws = []
    for one in rng.spawn(number):
        order = np.arange(stand.n) if stand.ordered else one.permutation(stand.n)
        draws.append((stand.blurred(one)[order], stand.species[order]))
    penalty, grid = roughness_penalty(shapes), likelihood_shape(stand, shapes)
    core_m = np.zeros_like(shapes.core_m) if stand.step_m else shapes.core_m

    def loss(flat: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        value, gradient = 0.5 * float(flat @ penalty @ flat), penalty @ flat
        for position_m, species in draws:
            found = score(
                position_m, species, shapes.kernel_of, shapes.knots_m, core_m,
                flat.reshape(shapes.free), stand.size_m, grid,
            )  # fmt: skip
            value -= found.log_likelihood / number
            gradient = gradient - found.gradient.ravel() / number
        return value, gradient

    start = np.zeros(shapes.free[0] * shapes.free[1])
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(-6.0, 4.0)] * len(start),
                     options={"maxiter": 40, "ftol": 1e-7})  # fmt: skip
    return np.asarray(found.x).reshape(shapes.free)
