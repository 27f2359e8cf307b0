"""Air to begin with: at rest, or moving with the wind, in balance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.parameters import Background, Surface, Velocity, background
from forestgen.atmosphere.fluid.pressure import Boundaries, Pressure, solid_cells
from forestgen.atmosphere.grid import AirGrid, Weather
from forestgen.atmosphere.sounding import Sounding, saturation_ratio

_NOISE_SHARE = 0.25  # of the box's height, at least four layers
_OVER = 1.01  # saturation that a sounding may show between its levels


def at_rest(
    grid: AirGrid, sounding: Sounding, surface: Surface | None, *, rng: np.random.Generator, noise_k: float = 0.0
) -> Weather:
    """Air in hydrostatic balance that moves with the sounding's wind, around the terrain.

    Potential temperature near the ground is even between plus and minus `noise_k`, cell by cell; there is none at a
    quarter of the box's height. Without any, air above an even ground does not know where to rise.

    Raises ValueError if the sounding is supersaturated in a layer, or the terrain reaches the top layer.
    """
    air = background(grid, sounding)
    _check_saturation(grid, air)
    solid = solid_cells(grid, surface)
    noise = rng.uniform(-noise_k, noise_k, grid.shape)
    fade = np.maximum(1 - np.arange(grid.cells[2]) / max(4, _NOISE_SHARE * grid.cells[2]), 0)[:, None, None]
    u, v, w = _wind_around(grid, air, solid)
    return Weather(
        grid=grid,
        time_s=0.0,
        east_m_per_s=u,
        north_m_per_s=v,
        up_m_per_s=w,
        potential_temperature_k=air.rest_k + (noise * fade).astype(np.float32),
        vapour=np.broadcast_to(air.vapour.astype(np.float32)[:, None, None], grid.shape).copy(),
        cloud=np.zeros(grid.shape, np.float32),
        rain=np.zeros(grid.shape, np.float32),
        fallen_kg_per_m2=np.zeros(grid.shape[1:]),
        density_kg_per_m3=air.density_kg_per_m3,
        temperature_ratio=air.temperature_ratio,
        solid=solid,
    )


def _wind_around(grid: AirGrid, air: Background, solid: NDArray[np.bool_] | None) -> Velocity:
    """The sounding's wind, made to flow around terrain."""
    u, v, w = (np.zeros(tuple(n + 4 for n in grid.shape), np.float32) for _ in range(3))
    u[2:-2], v[2:-2] = air.wind_m_per_s.T.astype(np.float32)[:, :, None, None]
    sides = Boundaries(solid)
    sides.apply((u, v, w))
    if solid is not None and air.wind_m_per_s.any():
        Pressure(grid, sides.openness).project((u, v, w))
        sides.apply((u, v, w))
    return u[2:-2, 2:-2, 2:-1].copy(), v[2:-2, 2:-1, 2:-2].copy(), w[2:-1, 2:-2, 2:-2].copy()


def _check_saturation(grid: AirGrid, air: Background) -> None:
    most = saturation_ratio(air.potential_temperature_k * air.temperature_ratio, air.pressure_pa)
    worst = int(np.argmax(air.vapour / most))
    if air.vapour[worst] > _OVER * most[worst]:
        raise ValueError(
            f"the sounding is supersaturated at {grid.layer_heights_m[worst]:.0f} m:"
            f" {air.vapour[worst]:.2e} kg/kg of vapour; expected at most {most[worst]:.2e}"
        )
