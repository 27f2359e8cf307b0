"""Air to begin with: at rest, or moving with the wind, in balance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.background import Background, background
from forestgen.atmosphere.fluid.boundaries import Boundaries, solid_cells
from forestgen.atmosphere.fluid.parameters import Surface
from forestgen.atmosphere.fluid.pressure import Pressure
from forestgen.atmosphere.sounding import Sounding, saturation_ratio
from forestgen.atmosphere.weather import AirGrid, Weather

_LEAST_CELLS = 4  # along an axis: the ghosts at joined sides are two deep
_NOISE_SHARE = 0.25  # of the box's height, at least four layers
_OVER = 1.01  # saturation that a sounding may show between its levels


def at_rest(
    grid: AirGrid, sounding: Sounding, surface: Surface | None, *, rng: np.random.Generator, noise_k: float = 0.0
) -> Weather:
    """Air in hydrostatic balance that moves with the sounding's wind, around the terrain.

    Parameters
    ----------
    noise_k : potential temperature near the ground is even between plus and minus this, cell by cell; none at a quarter
        of the box's height. Without any, air above an even ground does not know where to rise.

    Raises
    ------
    ValueError
        if the sounding is supersaturated in a layer, or the surface's maps do not fit the grid.
    """
    check_grid(grid, surface)
    if not (np.isfinite(noise_k) and noise_k >= 0):
        raise ValueError(f"noise_k is {noise_k}; expected a finite number, 0 or more")
    air = background(grid, sounding)
    _check_saturation(grid, air)
    solid = solid_cells(grid, surface.height_m if surface else None)
    noise = rng.uniform(-noise_k, noise_k, grid.shape)
    fade = np.maximum(1 - np.arange(grid.cells[2]) / max(4, _NOISE_SHARE * grid.cells[2]), 0)[:, None, None]
    theta = air.potential_temperature_k.astype(np.float32)[:, None, None] + (noise * fade).astype(np.float32)
    u, v, w = _wind_around(grid, air, solid)
    vapour = np.broadcast_to(air.vapour.astype(np.float32)[:, None, None], grid.shape).copy()
    return Weather(
        grid,
        0.0,
        u,
        v,
        w,
        theta,
        vapour,
        np.zeros(grid.shape, np.float32),
        np.zeros(grid.shape, np.float32),
        np.zeros(grid.shape[1:]),
        air.density_kg_per_m3,
        air.temperature_ratio,
        solid,
    )


def _wind_around(
    grid: AirGrid, air: Background, solid: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """The sounding's wind, made to flow around terrain."""
    u, v, w = (np.zeros(tuple(n + 4 for n in grid.shape), np.float32) for _ in range(3))
    u[2:-2], v[2:-2] = air.wind_m_per_s.T.astype(np.float32)[:, :, None, None]
    sides = Boundaries(grid, air.wind_m_per_s, solid)
    sides.apply((u, v, w))
    if solid is not None and air.wind_m_per_s.any():
        Pressure(grid, sides.openness).project((u, v, w))
        sides.apply((u, v, w))
    return u[2:-2, 2:-2, 2:-1].copy(), v[2:-2, 2:-1, 2:-2].copy(), w[2:-1, 2:-2, 2:-2].copy()


def check_grid(grid: AirGrid, surface: Surface | None) -> None:
    """Raises ValueError for grids and maps that cannot be simulated."""
    if min(grid.cells) < _LEAST_CELLS:
        raise ValueError(f"the grid has {grid.cells} cells along x, y, z; expected {_LEAST_CELLS} or more along each")
    if not all(np.isfinite(side) and side > 0 for side in grid.cell_m):
        raise ValueError(f"the cells measure {grid.cell_m} m; expected finite lengths above 0")
    if surface is None:
        return
    maps = {"heat": surface.heat_w_per_m2, "vapour": surface.vapour_kg_per_m2_s, "terrain": surface.height_m}
    for name, values in maps.items():
        if values is None:
            continue
        if values.shape != grid.shape[1:]:
            raise ValueError(f"the map of {name} has {values.shape} values; expected {grid.shape[1:]}: rows, columns")
        if not np.isfinite(values).all():
            raise ValueError(f"the map of {name} has values that are not finite")
    if surface.height_m is not None and surface.height_m.max() >= grid.layer_heights_m[-1]:
        raise ValueError(
            f"the terrain rises to {surface.height_m.max():.0f} m, to the top layer of the air"
            f" ({grid.layer_heights_m[-1]:.0f} m); expected a higher box"
        )


def _check_saturation(grid: AirGrid, air: Background) -> None:
    most = saturation_ratio(air.potential_temperature_k * air.temperature_ratio, air.pressure_pa)
    worst = int(np.argmax(air.vapour / most))
    if air.vapour[worst] > _OVER * most[worst]:
        raise ValueError(
            f"the sounding is supersaturated at {grid.layer_heights_m[worst]:.0f} m:"
            f" {air.vapour[worst]:.2e} kg/kg of vapour; expected at most {most[worst]:.2e}"
        )
