"""What the air is put into and how it behaves: the ground below it, and the constants of its motion and water."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

STABLE_COURANT = 0.87  # of third-order upwind fluxes with two-stage Runge and Kutta (Wicker & Skamarock 2002, Table 1)

STABLE_CONFINEMENT = (
    0.15  # a warm bubble: at 0.3 its eddies passed 150 m/s within four minutes; at 0.1 they stayed at 10
)


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
    diffusivity_m2_per_s: float = 0.0  # the same for heat and water; the seeds have none
    confinement: float = 0.05  # vorticity confinement (Fedkiw 2001): eddies at the grid's scale are kept alive; 0: not
    rain_fall_m_per_s: float = 10.0  # terminal velocity of drops (seeds 3.2.3.5); 0: none falls
    autoconversion_per_s: float = 1e-3  # alpha_A of Kessler (1969)
    autoconversion_threshold: float = 1e-3  # a_T, kg/kg (seeds)
    accretion_per_s: float = 5.2  # alpha_K of K = alpha_K q_c q_r; Kessler's 2.2 q_c q_r^0.875 at 1 g/kg
    evaporation: float = 1.0  # of rain, times the rate of Klemp & Wilhelmson (1978, Eq. 2.14); 0: none
    wind_relaxation_s: float | None = None  # time in which a layer's mean wind returns to the sounding's; None: never
    sponge_share: float = 0.2  # of the box's height, below the ceiling, in which vertical motion dies out; 0: none
    sponge_per_s: float = 0.02  # rate of that, at the ceiling
    courant: float = 0.7  # share of a cell that air may cross in a step, summed over the axes
    largest_step_s: float = 10.0
    fastest_m_per_s: float = 150.0  # air that is faster is taken for an instability

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{field.name} is {value}; expected a finite number, 0 or more")
        if not 0 < self.courant <= STABLE_COURANT:
            raise ValueError(f"courant is {self.courant}; steps are stable above 0 and up to {STABLE_COURANT}")
        if self.confinement > STABLE_CONFINEMENT:
            raise ValueError(
                f"confinement is {self.confinement}; up to {STABLE_CONFINEMENT} eddies do not grow on and on"
            )
        if self.sponge_share > 1:
            raise ValueError(f"sponge_share is {self.sponge_share}; it is a share of the box, 0 to 1")
        for name in ("largest_step_s", "fastest_m_per_s", "wind_relaxation_s"):
            if getattr(self, name) == 0:
                raise ValueError(f"{name} is 0; expected more")
