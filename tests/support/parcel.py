"""Cloud base and top predicted from a sounding: a parcel of warm, humid air that rises from the ground (Fig. 23).

The thermal starts at the ground with a temperature and a mass ratio of vapour, expands without exchange of heat as it
rises (Eq. 23), and is lifted by its lower density (Eq. 28).

- The base is where its relative humidity reaches 1.
- `neutral_m`, the paper's h0, is where its lift ends for good: the highest place that it reaches with lift left below.
- The top is where its motion has vanished: where the work of buoyancy on it, the integral of B dz, is back at 0.
  Of a lift that falls linearly that is 2 h0 (Fig. 23a). An inversion, air that grows warmer upwards, stops the thermal
  where it loses its lift (Fig. 23b): it then spreads under the inversion, a cumulonimbus' anvil.

With `latent_heat` off, as in the paper's first exploration, the thermal stays on its dry adiabat and keeps its vapour,
so that its relative humidity passes 1. With it on, a saturated thermal follows the moist adiabat (`humid_air`). Neither
mixes with the air around, and droplets weigh nothing, so a real top lies rather lower.

`FIG24` holds four skies that make the clouds of Fig. 24: the air at rest, two lapse rates with an inversion and one
relative humidity at all heights, and a thermal, warmer by `excess_k` and with its own vapour. The types that are
simulated have soundings of their own. Fog, stratocumulus and cumulus come out nearly the same with
latent heat on or off, because an inversion stops the moister climb; the thunderhead needs it: with the heat off, it
takes a lapse rate of nearly the dry adiabat's up to 8 km, which no real sky has.

| sky | ground | dT/dz, K/km | from | above | thermal | base to top, heat off | heat on |
|---|---|---|---|---|---|---|---|
| fog | 281.0 K, 95% | +10 | 200 m | -6.5 | +0.5 K, 6.8 g/kg | 0 to 29 m | 0 to 36 m |
| stratocumulus | 288.0 K, 40% | -7.2 | 1950 m | +10 | +2.3 K, 4.5 g/kg | 1798 to 1975 m | 1798 to 1997 m |
| cumulus | 290.0 K, 40% | -7.2 | 2400 m | +10 | +2.7 K, 6.4 g/kg | 1497 to 2481 m | 1497 to 2441 m |
| cumulonimbus | 297.0 K, 50% | -7.6 | 7800 m | +7 | +3.0 K, 10.4 g/kg | 1500 to 3549 m | 1500 to 8337 m, anvil |
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.sounding import Floats, Sounding, saturation_ratio
from support.humid_air import buoyancy_m_per_s2, density_kg_per_m3, dry_adiabat, moist_adiabat
from support.soundings import sounding_of_lapse_rates

_FINE_M, _FINE_UP_TO_M, _COARSE_M = 1.0, 500.0, 10.0  # steps of the heights that are looked at


@dataclass(frozen=True)
class Thermal:
    """Air at the ground that is about to rise."""

    temperature_k: float
    vapour: float  # kg/kg


@dataclass(frozen=True)
class Profiles:
    """Thermal and air by height, as Fig. 24 draws them. The thermal's values go on above its top, as if lifted."""

    height_m: Floats  # (N,) above the ground
    air_temperature_k: Floats  # (N,)
    thermal_temperature_k: Floats  # (N,)
    air_density_kg_per_m3: Floats  # (N,)
    thermal_density_kg_per_m3: Floats  # (N,)
    buoyancy_m_per_s2: Floats  # (N,)
    air_vapour: Floats  # (N,) kg/kg
    thermal_vapour: Floats  # (N,) kg/kg
    saturation: Floats  # (N,) kg/kg that the thermal can hold
    work_j_per_kg: Floats  # (N,) of buoyancy since the ground: half the upward speed's square while it rises
    saturated_m: float | None  # height at which the thermal is first saturated, if it ever is

    @property
    def air_relative_humidity(self) -> Floats:
        """(N,)."""
        pressure_ratio = saturation_ratio(self.air_temperature_k, 1.0) / saturation_ratio(
            self.thermal_temperature_k, 1.0
        )
        return self.air_vapour / (self.saturation * pressure_ratio)

    @property
    def thermal_relative_humidity(self) -> Floats:
        """(N,); above 1 in a cloud whose latent heat is off."""
        return self.thermal_vapour / self.saturation


@dataclass(frozen=True)
class CloudPrediction:
    """Where a thermal's cloud begins and ends. False if it makes none, with the reason."""

    base_m: float | None  # above the ground; None: no cloud
    top_m: float | None
    neutral_m: float  # where the thermal's lift ends
    spreads: bool  # an inversion stopped it: a flat top, an anvil
    fastest_m_per_s: float  # upward speed at `neutral_m`, without any friction
    reason: str = ""  # why there is no cloud

    def __bool__(self) -> bool:
        return self.base_m is not None


@dataclass(frozen=True)
class Sky:
    """A cloud type's weather in plain parameters: two lapse rates, and a thermal. See the module's page."""

    ground_temperature_k: float
    lapse_rate_k_per_m: float  # dT/dz below the inversion
    inversion_m: float
    lapse_rate_above_k_per_m: float  # dT/dz above it, up to top_m; constant from there
    top_m: float
    air_relative_humidity: float  # of the air at rest, at all heights
    excess_k: float  # of the thermal over the air at the ground
    thermal_vapour: float  # kg/kg at the ground
    domain_m: float  # a height that leaves room above the cloud
    latent_heat: bool = False

    def sounding(self) -> Sounding:
        """The air at rest."""
        return sounding_of_lapse_rates(
            ground_temperature_k=self.ground_temperature_k,
            lapse_rate_k_per_m=self.lapse_rate_k_per_m,
            inversion_m=self.inversion_m,
            lapse_rate_above_k_per_m=self.lapse_rate_above_k_per_m,
            top_m=self.top_m,
            relative_humidity=self.air_relative_humidity,
        )

    def thermal(self) -> Thermal:
        """The air that rises."""
        return Thermal(self.ground_temperature_k + self.excess_k, self.thermal_vapour)

    def prediction(self) -> CloudPrediction:
        """Base and top."""
        return predict_cloud(self.sounding(), self.thermal(), latent_heat=self.latent_heat)


FIG24: dict[str, Sky] = {
    "fog": Sky(
        ground_temperature_k=281.0,
        lapse_rate_k_per_m=0.01,
        inversion_m=200.0,
        lapse_rate_above_k_per_m=-0.0065,
        top_m=10_000.0,
        air_relative_humidity=0.95,
        excess_k=0.5,
        thermal_vapour=0.00682,
        domain_m=300.0,
    ),
    "stratocumulus": Sky(
        ground_temperature_k=288.0,
        lapse_rate_k_per_m=-0.0072,
        inversion_m=1950.0,
        lapse_rate_above_k_per_m=0.010,
        top_m=2500.0,
        air_relative_humidity=0.4,
        excess_k=2.3,
        thermal_vapour=0.00454,
        domain_m=3000.0,
    ),
    "cumulus": Sky(
        ground_temperature_k=290.0,
        lapse_rate_k_per_m=-0.0072,
        inversion_m=2400.0,
        lapse_rate_above_k_per_m=0.010,
        top_m=3000.0,
        air_relative_humidity=0.4,
        excess_k=2.7,
        thermal_vapour=0.00637,
        domain_m=4000.0,
    ),
    "cumulonimbus": Sky(
        ground_temperature_k=297.0,
        lapse_rate_k_per_m=-0.0076,
        inversion_m=7800.0,
        lapse_rate_above_k_per_m=0.007,
        top_m=10_000.0,
        air_relative_humidity=0.5,
        excess_k=3.0,
        thermal_vapour=0.01037,
        domain_m=12_000.0,
        latent_heat=True,
    ),
}


def predict_cloud(sounding: Sounding, thermal: Thermal, *, latent_heat: bool = True) -> CloudPrediction:
    """Base and top of the cloud that a thermal makes in a sounding.

    A thermal that makes no cloud is a result too: it is false, and says why.
    """
    return prediction_of(thermal_profiles(sounding, thermal, latent_heat=latent_heat))


def prediction_of(profiles: Profiles) -> CloudPrediction:
    """Base and top, of a thermal's profiles."""
    z, lift = profiles.height_m, profiles.buoyancy_m_per_s2
    if lift[0] <= 0.0 and not lift[1] > 0.0:
        wet = "saturated, but " if profiles.saturated_m == 0.0 else ""
        reason = f"the thermal is {wet}not lighter than the air at the ground: it does not rise"
        return CloudPrediction(None, None, 0.0, False, 0.0, reason)
    neutral, top, spreads = _end_of_rise(profiles)
    speed = float(np.sqrt(2.0 * max(0.0, np.interp(neutral, z, profiles.work_j_per_kg))))
    base = profiles.saturated_m
    if base is None or base >= top:
        damp = float(np.interp(top, z, profiles.thermal_relative_humidity))
        reason = f"the thermal comes to rest at {top:.0f} m with a relative humidity of {damp:.2f}, below 1"
        return CloudPrediction(None, None, neutral, spreads, speed, reason)
    return CloudPrediction(base, top, neutral, spreads, speed)


def thermal_profiles(
    sounding: Sounding, thermal: Thermal, *, latent_heat: bool = True, top_m: float | None = None
) -> Profiles:
    """A thermal and the air around it, from the ground to a height.

    Parameters
    ----------
    top_m : the highest height; twice the sounding's last, at least 15 km, if not given.
    """
    highest = max(2.0 * float(sounding.height_m[-1]), 15_000.0) if top_m is None else top_m
    z = np.concatenate(
        [np.arange(0.0, _FINE_UP_TO_M, _FINE_M), np.arange(_FINE_UP_TO_M, highest, _COARSE_M), [highest]]
    )
    z = np.unique(np.concatenate([z, sounding.height_m]))
    z = z[z <= highest]
    pressure, air_k, air_vapour = sounding.pressure_at(z), sounding.temperature_at(z), sounding.vapour_at(z)
    warmth = dry_adiabat(thermal.temperature_k, pressure[0], pressure, thermal.vapour)
    vapour, over = np.full_like(z, thermal.vapour), thermal.vapour / saturation_ratio(warmth, pressure) - 1.0
    base = _crossing(z, over, np.flatnonzero(over >= 0.0))
    if latent_heat and base is not None:
        warmth, vapour = _wet_from(base, z, pressure, warmth, thermal.vapour)
    lift = buoyancy_m_per_s2(warmth, vapour, air_k, air_vapour)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (lift[1:] + lift[:-1]) * np.diff(z))])
    return Profiles(
        height_m=z,
        air_temperature_k=air_k,
        thermal_temperature_k=warmth,
        air_density_kg_per_m3=density_kg_per_m3(air_k, pressure, air_vapour),
        thermal_density_kg_per_m3=density_kg_per_m3(warmth, pressure, vapour),
        buoyancy_m_per_s2=lift,
        air_vapour=air_vapour,
        thermal_vapour=vapour,
        saturation=saturation_ratio(warmth, pressure),
        work_j_per_kg=work,
        saturated_m=base,
    )


def _wet_from(base_m: float, z: Floats, pressure: Floats, warmth: Floats, vapour: float) -> tuple[Floats, Floats]:
    """Temperature and vapour of a thermal whose dry adiabat is left for the moist one at the cloud's base."""
    start_k, start_pa = np.interp(base_m, z, warmth), np.exp(np.interp(base_m, z, np.log(pressure)))
    wet = z >= base_m
    warmth, ratio = warmth.copy(), np.full_like(z, vapour)
    warmth[wet] = moist_adiabat(float(start_k), float(start_pa), np.minimum(pressure[wet], start_pa))
    ratio[wet] = np.minimum(vapour, saturation_ratio(warmth[wet], pressure[wet]))
    return warmth, ratio


def _end_of_rise(profiles: Profiles) -> tuple[float, float, bool]:
    """Height at which lift ends for good, height at which motion ends, and whether an inversion ended it."""
    z, lift, work = profiles.height_m, profiles.buoyancy_m_per_s2, profiles.work_j_per_kg
    spent = np.flatnonzero((work <= 0.0) & (z > 0.0) & (lift < 0.0))
    last = int(spent[0]) if len(spent) else len(z) - 1
    neutral = 0.0
    for k in range(last):
        if lift[k] > 0.0 >= lift[k + 1]:
            neutral = float(z[k] + lift[k] / (lift[k] - lift[k + 1]) * (z[k + 1] - z[k]))
            if profiles.air_temperature_k[k + 1] > profiles.air_temperature_k[k]:
                return neutral, neutral, True
    if not len(spent):
        return neutral or float(z[-1]), float(z[-1]), False
    top = _crossing(z, -work, spent)
    return neutral, float(z[last] if top is None else top), False


def _crossing(z: Floats, value: Floats, positive: NDArray[np.intp]) -> float | None:
    """Height at which a value reaches 0 from below, given the indices at which it is not negative."""
    if len(positive) == 0:
        return None
    k = int(positive[0])
    if k == 0:
        return float(z[0])
    share = -value[k - 1] / (value[k] - value[k - 1])
    return float(z[k - 1] + share * (z[k] - z[k - 1]))
