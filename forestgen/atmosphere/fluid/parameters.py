"""What the air is put into and how it behaves: the ground, constants of motion and water, air at rest, and step limits.

Air at rest is what the moving air is compared with, by layer. Pressure, density and Exner's function come from the
sounding and stay (Boussinesq). The flow has one density, that of the lowest layer: so heat and vapour from the ground
and rain on it are what they are in nature.

Limits of a step: the air crosses at most a share of a cell (Courant), also while buoyancy speeds it up; viscosity
reaches no further than a cell; a gravity wave's step times its frequency stays under 2 (the staggered steps of heat
and wind are a leapfrog).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import AirGrid, Weather
from forestgen.atmosphere.sounding import (
    AIR_EXPONENT,
    AIR_KG_PER_KMOL,
    GAS_CONSTANT_AIR_J_PER_KG_K,
    REFERENCE_PA,
    WATER_KG_PER_KMOL,
    Sounding,
)
from forestgen.core.threads import at_once, over_slabs

HEAT_CAPACITY_J_PER_KG_K = GAS_CONSTANT_AIR_J_PER_KG_K / AIR_EXPONENT  # of dry air at constant pressure
VAPOUR_LIGHTNESS = AIR_KG_PER_KMOL / WATER_KG_PER_KMOL - 1  # 0.607: what a unit of vapour adds to virtual temperature
Floats = NDArray[np.float64]
Field = NDArray[np.float32]
Velocity = tuple[Field, Field, Field]  # east, north, up
AXES = ((0, 0, 1), (0, 1, 0), (1, 0, 0))  # a step along x, y and z in the arrays


class UnstableError(ValueError):
    """The air cannot be stepped on: the step is too long, or the field is not finite, or faster than any air."""


@dataclass(frozen=True)
class Surface:
    """What the ground gives off, and its shape."""

    heat_w_per_m2: NDArray[np.float32]  # (Y, X) sensible heat, upwards; negative: the ground cools the air
    vapour_kg_per_m2_s: NDArray[np.float32]  # (Y, X) upwards; negative: dew
    height_m: NDArray[np.float64] | None = None  # (Y, X) terrain above the datum; None: flat, at the grid's floor


@dataclass(frozen=True)
class Physics:
    """Constants of the motion and of the water."""

    viscosity_m2_per_s: float = 1.0  # nu of Eq. 33, of eddies smaller than a cell; the molecules' 1.5e-5 is not felt
    # Vorticity confinement (Fedkiw 2001): eddies at the grid's scale are kept alive; 0: not. Those of a warm bubble
    # stayed at 10 m/s with 0.1, and passed 150 m/s within four minutes with 0.3.
    confinement: float = 0.05
    rain_fall_m_per_s: float = 10.0  # terminal velocity of drops (seeds 3.2.3.5); 0: none falls
    autoconversion_per_s: float = 1e-3  # alpha_A of Kessler (1969)
    autoconversion_threshold: float = 1e-3  # a_T, kg/kg (seeds)
    accretion_per_s: float = 5.2  # alpha_K of K = alpha_K q_c q_r; Kessler's 2.2 q_c q_r^0.875 at 1 g/kg
    evaporation: float = 1.0  # of rain, times the rate of Klemp & Wilhelmson (1978, Eq. 2.14); 0: none
    wind_relaxation_s: float | None = None  # time in which a layer's mean wind returns to the sounding's; None: never
    sponge_share: float = 0.2  # of the box's height, below the ceiling, in which vertical motion dies out; 0: none
    sponge_per_s: float = 0.02  # rate of that, at the ceiling
    # Share of a cell that air may cross in a step, summed over the axes; third-order upwind fluxes with two-stage Runge
    # and Kutta are stable up to 0.87 (Wicker & Skamarock 2002, Table 1).
    courant: float = 0.7
    largest_step_s: float = 10.0
    fastest_m_per_s: float = 150.0  # air that is faster is taken for an instability


@dataclass(frozen=True)
class Background:
    """The air at rest, at the layers' centres; `lift_per_k` at the faces between them."""

    potential_temperature_k: Floats  # (Z,)
    vapour: Floats  # (Z,) kg/kg
    wind_m_per_s: Floats  # (Z, 2)
    temperature_ratio: Floats  # (Z,) Exner's function
    density_kg_per_m3: Floats  # (Z,)
    pressure_pa: Floats  # (Z,)
    lift_per_k: Floats  # (Z + 1,) m/s2 of buoyancy per kelvin at the faces: g over potential temperature; 0 at the ends

    @property
    def rest_k(self) -> Field:
        """(Z, 1, 1) potential temperature."""
        return self.potential_temperature_k.astype(np.float32)[:, None, None]

    @property
    def flow_density_kg_per_m3(self) -> float:
        return float(self.density_kg_per_m3[0])


def background(grid: AirGrid, sounding: Sounding) -> Background:
    """The sounding in the grid's layers."""
    height = grid.layer_heights_m
    ratio = sounding.temperature_ratio_at(height)
    # g / theta at a face is c_p times the fall of Exner's function across it (hydrostatic balance): with this very
    # value the work of buoyancy and the change of enthalpy balance in the discrete equations too.
    lift = np.zeros(len(height) + 1)
    lift[1:-1] = HEAT_CAPACITY_J_PER_KG_K * -np.diff(ratio) / grid.cell_m[2]
    return Background(
        sounding.potential_temperature_at(height),
        sounding.vapour_at(height),
        sounding.wind_at(height),
        ratio,
        sounding.density_at(height),
        REFERENCE_PA * ratio ** (1 / AIR_EXPONENT),
        lift,
    )


def crossing_per_s(velocity: Velocity, cell_m: tuple[float, float, float]) -> float:
    """Largest rate at which air leaves a cell through its faces, in cells a second; the ghosts are filled."""
    layers, rows, columns = velocity[0].shape
    most: list[float] = []

    def work(first: int, end: int) -> None:
        total: Any = np.float32(0)
        for field, side, (z, y, x) in zip(velocity, cell_m, AXES, strict=True):
            low = field[first + 2 : end + 2, 2:-2, 2:-2]
            high = field[first + 2 + z : end + 2 + z, 2 + y : rows - 2 + y, 2 + x : columns - 2 + x]
            # fmax and fmin: what is no number is found, and named, where fields are checked
            total = total + (np.fmax(high, 0) - np.fmin(low, 0)) * np.float32(1 / side)
        most.append(float(total.max()))

    over_slabs(layers - 4, (rows - 4) * (columns - 4), work)
    return max(most)


def fixed_limit_s(grid: AirGrid, air: Background, physics: Physics) -> float:
    """What the air at rest and the constants allow, whatever the wind."""
    limit = physics.largest_step_s
    if physics.viscosity_m2_per_s > 0:
        limit = min(limit, 0.25 / (physics.viscosity_m2_per_s * sum(1 / side**2 for side in grid.cell_m)))
    # The frequency of the fastest gravity wave of the air at rest (Brunt and Vaisala's).
    rise = air.lift_per_k[1:-1] * np.diff(air.potential_temperature_k) / grid.cell_m[2]
    wave = math.sqrt(max(0.0, float(rise.max(initial=0.0))))
    return min(limit, 1.0 / wave) if wave > 0 else limit


def moving_limit_s(crossing_per_s: float, lift_m_per_s2: float, thickness_m: float, courant: float) -> float:
    """The step after which Courant's number reaches `courant`, with buoyancy speeding the air up meanwhile."""
    speeding = lift_m_per_s2 / thickness_m  # cells / s2
    if speeding <= 0:
        return courant / crossing_per_s if crossing_per_s > 0 else math.inf
    # crossing t + speeding t^2 / 2 = courant, written so that nothing cancels
    root = math.sqrt(crossing_per_s**2 + 2 * speeding * courant)
    return 2 * courant / (crossing_per_s + root)


def check_fields(weather: Weather) -> None:
    """Raises UnstableError where a field is not finite."""
    names = ("east wind", "north wind", "upward wind", "potential temperature", "vapour", "cloud", "rain")
    wind = (weather.east_m_per_s, weather.north_m_per_s, weather.up_m_per_s)
    fields = (*wind, weather.potential_temperature_k, weather.vapour, weather.cloud, weather.rain)
    sums = at_once([partial(np.add.reduce, field, axis=None) for field in fields])
    for name, field, total in zip(names, fields, sums, strict=True):
        if np.isfinite(total):
            continue
        bad = np.argwhere(~np.isfinite(field))
        if len(bad):  # else the sum alone is too large
            layer, row, column = (int(n) for n in bad[0])
            raise UnstableError(
                f"{name} is {field[layer, row, column]} in layer {layer}, row {row}, column {column}"
                f" and in {len(bad) - 1} other places; expected finite numbers"
            )
