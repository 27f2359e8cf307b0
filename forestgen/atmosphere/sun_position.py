"""Where the sun stands, by date, time and place.

NREL's solar position algorithm (Reda and Andreas 2004), in pvlib's implementation: within 0.0003 degrees of the
almanac from the year -2000 to 6000. Refraction lifts a low sun: the elevation is that at which it is seen, for the air
pressure of the place's altitude and 12 degrees Celsius.

References
----------
Reda, I., Andreas, A. (2004): Solar position algorithm for solar radiation applications. Solar Energy 76, 577-589.
Anderson, K. S., et al. (2023): pvlib python: 2023 project update. J. Open Source Softw. 8, 5994.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache

from forestgen.atmosphere.spctrl2 import pressure_pa

_MEAN_TEMPERATURE_C = 12.0


@dataclass(frozen=True)
class SunPosition:
    """The sun as it is seen from a place."""

    elevation_deg: float  # over the horizon, refraction included
    azimuth_deg: float  # clockwise from north, [0, 360)
    distance_au: float  # from the earth


@lru_cache(maxsize=256)
def sun_position(
    moment: datetime,
    latitude_deg: float,
    longitude_deg: float,
    altitude_m: float = 0.0,
    *,
    air_pressure_pa: float | None = None,
    temperature_c: float = _MEAN_TEMPERATURE_C,
) -> SunPosition:
    """The sun's place in the sky.

    Parameters
    ----------
    moment : date and time, with its offset from UTC.
    latitude_deg, longitude_deg : north and east positive.
    altitude_m : above sea level.
    air_pressure_pa : None is that of the standard atmosphere at the altitude.

    Raises
    ------
    ValueError : the moment does not tell its offset from UTC.
    """
    if moment.tzinfo is None:
        raise ValueError("a moment needs its offset from UTC")
    import pandas
    from pvlib.solarposition import nrel_earthsun_distance, spa_python

    times = pandas.DatetimeIndex([moment])
    one = spa_python(
        times,
        latitude_deg,
        longitude_deg,
        altitude=altitude_m,
        pressure=pressure_pa(altitude_m) if air_pressure_pa is None else air_pressure_pa,
        temperature=temperature_c,
        delta_t=None,  # by year and month
    ).iloc[0]
    distance = nrel_earthsun_distance(times, delta_t=None).iloc[0]
    return SunPosition(float(one["apparent_elevation"]), float(one["azimuth"]) % 360.0, float(distance))
