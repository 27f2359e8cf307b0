"""Buoyancy, and vapour, droplets and drops: Kessler's scheme (Eqs. 35 to 37) and saturation (Eqs. 29, 34).

Buoyancy. Eq. 28 is g (M_air/M_th T_th/T_air - 1): the ratio of the two virtual temperatures. At one pressure T_th/T_air
is the ratio of the potential temperatures; where the surroundings are moist too, theirs is also lighter; M_air/M of air
with vapour q_v is 1 + 0.607 q_v. To first order, with the weight of drops and droplets, which Eq. 28 leaves out,

    b = g [theta'/theta_0 + 0.607 q_v' - q_c - q_r],

with primes for differences from the air at rest.

Phases. A step's sources, cell by cell: autoconversion A = alpha_A (q_c - a_T) and accretion K = alpha_K q_c q_r turn
droplets into drops; drops evaporate in dry air (Klemp & Wilhelmson 1978, after Ogura & Takahashi 1971); last, vapour
condenses or droplets evaporate until the air is just saturated or no droplet is left (Soong & Ogura 1973), with
c_p Pi theta + L q_v unchanged: up to three steps of Newton's method. Each amount is at most what there is, so no
ratio is negative and water is conserved to rounding.

Drops fall at one speed: the column is shifted by whole cells, and the rest of the way by a limited flux, at any
length of step. What reaches the ground, flat or terrain, is counted there.

Fields of cells are (Z + 4, Y + 4, X + 4). Heat is potential temperature less that at rest, K; the others are kg/kg.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.parameters import HEAT_CAPACITY_J_PER_KG_K, VAPOUR_LIGHTNESS, Background, Physics
from forestgen.atmosphere.sounding import GRAVITY_M_PER_S2, LATENT_HEAT_J_PER_KG
from forestgen.core.compiled import unchecked, unowned_view
from forestgen.core.threads import over_slabs

Field = NDArray[np.float32]
_HALF = np.float32(0.5)
_ZERO, _ONE = np.float32(0), np.float32(1)
_LITTLE = np.float32(1e-8)  # kg/kg: a step of Newton's method this short is the last
# Bolton's saturation ratio (Eq. 29), celsius = T - 273.15.
_SCALE_PA, _SLOPE, _ORIGIN_K, _FREEZING_K = np.float32(380.16), np.float32(17.67), np.float32(29.65), np.float32(273.15)
_LATENT_K = np.float32(LATENT_HEAT_J_PER_KG / HEAT_CAPACITY_J_PER_KG_K)  # warming by condensation of 1 kg/kg


def lift(out: Field, heat: Field, vapour: Field, cloud: Field, rain: Field, air: Background, share: float) -> None:
    """out = share x buoyancy + (1 - share) x out, at the faces between layers (Z + 1, Y, X), m/s2; the ends stay 0."""
    per_k = air.lift_per_k.astype(np.float32)
    still = air.vapour.astype(np.float32)
    rest = still[1:] + still[:-1]  # of just such numbers as the fields hold: air at rest has no buoyancy at all
    layers, rows, columns = out.shape
    light, gravity = np.float32(VAPOUR_LIGHTNESS), np.float32(0.5 * GRAVITY_M_PER_S2)
    new, old = np.float32(share), np.float32(1 - share)

    def work(first: int, end: int) -> None:
        low, high = (slice(first + k, end + k) for k in (2, 3))  # of cells, below and above the faces
        (warm, hot), (damp, wet), (c, d), (e, f) = (
            [field[part, 2:-2, 2:-2] for part in (low, high)] for field in (heat, vapour, cloud, rain)
        )
        moist = light * ((damp + wet) - rest[first:end, None, None]) - ((c + e) + (d + f))
        scale, to = (_HALF * per_k)[first + 1 : end + 1, None, None], out[first + 1 : end + 1]
        to[:] = new * (scale * (warm + hot) + gravity * moist) + old * to

    over_slabs(layers - 2, rows * columns, work)


def carry_rest(heat: Field, up: Field, air: Background, step_s: float, thickness_m: float) -> None:
    """heat -= step x w d(theta_0)/dz, conserving its sum; `up` is the vertical velocity w at the faces."""
    jump = np.zeros(len(air.potential_temperature_k) + 1)
    jump[1:-1] = np.diff(air.potential_temperature_k)
    slope = (0.5 * step_s / thickness_m * jump).astype(np.float32)
    faces, inner = slope[:, None, None] * up[2:-1, 2:-2, 2:-2], heat[2:-2, 2:-2, 2:-2]
    inner -= faces[:-1] + faces[1:]


def change_phases(
    heat: Field, vapour: Field, cloud: Field, rain: Field, air: Background, physics: Physics, step_s: float
) -> None:
    """The step's condensation, evaporation and growth of drops, in place."""
    rest, exner, pressure, density = (
        values.astype(np.float32)
        for values in (air.potential_temperature_k, air.temperature_ratio, air.pressure_pa, air.density_kg_per_m3)
    )
    gone = np.float32(-np.expm1(-physics.autoconversion_per_s * step_s))
    threshold, swept = np.float32(physics.autoconversion_threshold), np.float32(physics.accretion_per_s * step_s)
    given = (rest, exner, pressure, density, gone, threshold, swept, np.float32(physics.evaporation * step_s))
    layers, rows, columns = heat.shape
    size = (rows - 4) * (columns - 4)
    over_slabs(layers - 4, size, lambda a, b: _change(heat, vapour, cloud, rain, *given, a, b))


@unchecked
def _change(heat, vapour, cloud, rain, rest, exner, pressure, density, gone, threshold, swept, drying, first, end):  # type: ignore[no-untyped-def]
    heat, vapour, cloud, rain = unowned_view((heat, vapour, cloud, rain))
    rows, columns = heat.shape[1], heat.shape[2]
    for k in range(first, end):
        ratio, per_pa, warming = exner[k], _SCALE_PA / pressure[k], _LATENT_K / exner[k]
        for j in range(2, rows - 2):
            row_h, row_v, row_c, row_r = heat[k + 2, j], vapour[k + 2, j], cloud[k + 2, j], rain[k + 2, j]
            for i in range(2, columns - 2):
                h, v, c, r = row_h[i], row_v[i], row_c[i], row_r[i]
                if c > _ZERO:
                    grown = gone * (c - threshold) if c > threshold else _ZERO
                    c -= grown
                    sweep = swept * r
                    caught = c * sweep / (_ONE + sweep)
                    c -= caught
                    r += grown + caught
                saturated, slope = _saturation(ratio * (rest[k] + h), per_pa)
                if r > _ZERO and v < saturated:
                    dried = drying * _drying_per_s(v / saturated, saturated, r, density[k], pressure[k])
                    most = (saturated - v) / (_ONE + _LATENT_K * slope)
                    dried = dried if dried < most else most
                    dried = dried if dried < r else r
                    r -= dried
                    v += dried
                    h -= warming * dried
                    saturated, slope = _saturation(ratio * (rest[k] + h), per_pa)
                if c > _ZERO or v > saturated:
                    for turn in range(3):
                        if turn > 0:
                            saturated, slope = _saturation(ratio * (rest[k] + h), per_pa)
                        wet = (v - saturated) / (_ONE + _LATENT_K * slope)
                        wet = wet if wet > -c else -c
                        c += wet
                        v -= wet
                        h += warming * wet
                        if abs(wet) < _LITTLE:
                            break
                row_h[i], row_v[i], row_c[i], row_r[i] = h, v, c, r


@unchecked
def _saturation(temperature, per_pa):  # type: ignore[no-untyped-def]
    """Saturation ratio, and its change per kelvin."""
    above = temperature - _ORIGIN_K
    ratio = per_pa * np.exp(_SLOPE * (temperature - _FREEZING_K) / above)
    return ratio, ratio * _SLOPE * (_FREEZING_K - _ORIGIN_K) / (above * above)


@unchecked
def _drying_per_s(humidity, saturated, rain, density, pressure):  # type: ignore[no-untyped-def]
    """Evaporation of drops in kg/kg/s; the published fit has g/cm3 and mbar."""
    water = np.log(np.float64(density) * 1e-3 * np.float64(rain))
    ventilation = 1.6 + 124.9 * np.exp(0.2046 * water)
    rate = (1.0 - humidity) * ventilation * np.exp(0.525 * water) / (5.4e5 + 2.55e6 / (0.01 * pressure * saturated))
    return np.float32(rate / (density * 1e-3))


def fall(
    rain: Field,
    fallen_kg_per_m2: NDArray[np.float64],
    ground: NDArray[np.int64],
    distance_m: float,
    thickness_m: float,
    flow_density_kg_per_m3: float,
) -> None:
    """Drops fall by a distance, the rest into `fallen_kg_per_m2` (Y, X); `ground` (Y, X) is the lowest cell of air."""
    whole, part = divmod(distance_m / thickness_m, 1.0)
    layers, rows, columns = rain.shape
    cells, share, mass = min(int(whole), layers - 4), np.float32(part), flow_density_kg_per_m3 * thickness_m
    number = np.arange(layers - 4)[:, None, None]

    def work(first: int, end: int) -> None:
        here, lowest = rain[2:-2, first + 2 : end + 2, 2:-2], ground[first:end]
        raining = (here > 0).any(axis=0)
        lost = np.cumsum(np.where(number - cells < lowest, here, 0), axis=0, dtype=np.float64)[-1]
        shifted = np.zeros((layers - 2, *lowest.shape), np.float32)  # by whole cells; nothing above and below
        shifted[1 : layers - 3 - cells] = np.where(number[cells:] - cells >= lowest, here[cells:], 0)
        flux = np.zeros((layers - 3, *lowest.shape), np.float32)  # through the bottom of each; none through the ceiling
        flux[:-1] = _drop(shifted[2:], shifted[1:-1], shifted[:-2], share, number == lowest)
        lost += np.take_along_axis(flux, lowest[None], axis=0)[0]
        after = np.maximum((shifted[1:-1] - flux[:-1]) + flux[1:], _ZERO)
        here[:] = np.where(raining & (number >= lowest), after, here)
        fallen_kg_per_m2[first:end] += np.where(raining, mass * lost, 0.0)

    over_slabs(rows - 4, (layers - 4) * (columns - 4), work)


def _drop(above: Field, here: Field, below: Field, share: np.float32, at_ground: NDArray[np.bool_]) -> Field:
    """Flux of columns that move down by a share of a cell (see `advection`)."""
    ahead, behind = below - here, here - above
    want = share * (_ONE - share) * abs((np.float32(2) - share) * ahead + (_ONE + share) * behind) / np.float32(6)
    size = np.minimum(want, np.minimum(share * abs(ahead), (_ONE - share) * abs(behind)))
    size = np.where((ahead * behind <= 0) | at_ground, _ZERO, np.where(ahead > 0, size, -size))
    return np.asarray(share * here + size)
