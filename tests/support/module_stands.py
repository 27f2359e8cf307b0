"""Made-up stands of branch modules: spheres in crowns, as many and as dense as in a simulated forest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PLANTS_PER_M2 = 0.117  # 468,000 on 4 km2
_TREES, _MODULES = 0.25, 16.4  # share of trees, mean number of modules of one; others have one module


@dataclass(frozen=True)
class ModuleStand:
    """Bounding spheres of modules, one row each; those of a plant together, each borne by the row before."""

    centre_m: NDArray[np.float64]  # (M, 3) world frame
    height_m: NDArray[np.float64]  # (M,) of the centre above the ground, which has hills of 30 m
    radius_m: NDArray[np.float64]  # (M,)
    parent_row: NDArray[np.int64]  # (M,) -1: a root
    period_m: tuple[float, float]  # of the torus that it stands on

    def __len__(self) -> int:
        return len(self.radius_m)


def module_stand(plants: int, seed: int, *, density: float = PLANTS_PER_M2) -> ModuleStand:
    """Trees of 10 to 18 m with conical crowns, and seedlings; about 5 modules a plant."""
    rng = np.random.default_rng(seed)
    side = float(np.sqrt(plants / density))
    modules = np.where(rng.random(plants) < _TREES, rng.poisson(_MODULES, plants) + 1, 1)
    plant = np.repeat(np.arange(plants), modules)
    m, tree = len(plant), (modules > 1)[plant]
    foot, tall = rng.uniform(0, side, (plants, 2)), rng.uniform(10, 18, plants)
    share, bearing = rng.random(m), rng.uniform(0, 2 * np.pi, m)
    out = np.where(tree, 2.5 * (1.1 - share) * np.sqrt(rng.random(m)), 0.0)
    height = np.where(tree, tall[plant] * share, 0.2)
    ground = 30 * np.sin(foot[:, 0] * 2 * np.pi / side)
    centre = np.stack(
        [
            foot[plant, 0] + out * np.cos(bearing),
            foot[plant, 1] + out * np.sin(bearing),
            height + ground[plant],
        ],
        axis=1,
    )
    radius = np.where(tree, rng.uniform(0.15, 1.0, m), rng.uniform(0.03, 0.3, m))
    first = np.cumsum(modules) - modules
    parent = np.where(np.arange(m) == first[plant], -1, np.arange(m) - 1)
    return ModuleStand(centre, height, radius, parent, (side, side))
