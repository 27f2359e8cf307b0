"""What moving air conserves: energy and volume. In double precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.parameters import HEAT_CAPACITY_J_PER_KG_K, VAPOUR_LIGHTNESS
from forestgen.atmosphere.grid import Weather
from forestgen.atmosphere.sounding import GRAVITY_M_PER_S2, LATENT_HEAT_J_PER_KG

Floats = NDArray[np.float64]


def energies_j(weather: Weather) -> dict[str, float]:
    """Parts of the energy, J: their sum is what the equations keep in a closed box, but for three small things.

    Motion that viscosity and the fluxes damp is lost, and so is the height of drops that fall: neither is given back
    as heat. And latent heat has no part in lifting: phases that change at height z leave 1.6 g z q open, 1% of the
    latent heat at 1.5 km, about what the true change of L with temperature is.

    enthalpy : c_p Pi theta. It has the potential energy of warm and cold air in it: Pi falls with height just so that
        rising air gives up what buoyancy gives to the motion.
    latent : L q_v.
    weight : of drops and droplets, less the lightness of vapour: g z (q_c + q_r - 0.607 q_v).
    motion : half the square of the velocity.
    """
    mass = _cell_kg(weather)
    exner, height = weather.temperature_ratio[:, None, None], weather.grid.layer_heights_m[:, None, None]
    vapour, theta = _air(weather, weather.vapour), _air(weather, weather.potential_temperature_k)
    load = _air(weather, weather.cloud) + _air(weather, weather.rain) - VAPOUR_LIGHTNESS * vapour
    u, v, w = weather.east_m_per_s, weather.north_m_per_s, weather.up_m_per_s
    squares = sum(
        float((_middle(field.astype(np.float64) ** 2, axis)).sum()) for axis, field in ((2, u), (1, v), (0, w))
    )
    return {
        "enthalpy": mass * HEAT_CAPACITY_J_PER_KG_K * float((exner * theta).sum()),
        "latent": mass * LATENT_HEAT_J_PER_KG * float(vapour.sum()),
        "weight": mass * GRAVITY_M_PER_S2 * float((height * load).sum()),
        "motion": 0.5 * mass * squares,
    }


def total_energy_j(weather: Weather) -> float:
    """Sum of `energies_j`."""
    return sum(energies_j(weather).values())


def divergence_per_s(weather: Weather) -> Floats:
    """(Z, Y, X) of the velocity (Eq. 32)."""
    x, y, z = weather.grid.cell_m
    u, v, w = (field.astype(np.float64) for field in (weather.east_m_per_s, weather.north_m_per_s, weather.up_m_per_s))
    return np.asarray(np.diff(u, axis=2) / x + np.diff(v, axis=1) / y + np.diff(w, axis=0) / z)


def _middle(faces: Floats, axis: int) -> Floats:
    """Means of a cell's two faces."""
    low, high = [slice(None)] * 3, [slice(None)] * 3
    low[axis], high[axis] = slice(None, -1), slice(1, None)
    return np.asarray(0.5 * (faces[tuple(low)] + faces[tuple(high)]))


def _air(weather: Weather, field: NDArray[np.float32]) -> Floats:
    values = field.astype(np.float64)
    return values if weather.solid is None else np.where(weather.solid, 0.0, values)


def _cell_kg(weather: Weather) -> float:
    return (
        weather.grid.cell_m[0] * weather.grid.cell_m[1] * weather.grid.cell_m[2] * float(weather.density_kg_per_m3[0])
    )
