"""A state of the air on another grid: where a story goes from fog to thunderheads, cells of 5 m become cells of 200 m.

Values are linear between the old cells' centres, after a Gaussian as wide as the new cells where those are larger.
Sideways the old box goes on periodically; above its ceiling the air is that of the new sounding. Velocities are
interpolated too: they are free of divergence again after the next step's pressure.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.weather import AirGrid, Weather

_Field = NDArray[np.float32]


def regridded(weather: Weather, fresh: Weather) -> Weather:
    """The air of `weather` on the grid of `fresh`, whose values hold above the old ceiling and for the air at rest."""
    if weather.grid == fresh.grid:
        return replace(weather, density_kg_per_m3=fresh.density_kg_per_m3, temperature_ratio=fresh.temperature_ratio)
    old, new = weather.grid, fresh.grid

    def moved(name: str, faces: int | None = None) -> _Field:
        return _moved(getattr(weather, name), getattr(fresh, name), old, new, faces)

    fallen = np.full(new.shape[1:], float(weather.fallen_kg_per_m2.mean()))
    return replace(
        fresh,
        time_s=weather.time_s,
        east_m_per_s=moved("east_m_per_s", 2),
        north_m_per_s=moved("north_m_per_s", 1),
        up_m_per_s=moved("up_m_per_s", 0),
        potential_temperature_k=moved("potential_temperature_k"),
        vapour=moved("vapour"),
        cloud=moved("cloud"),
        rain=moved("rain"),
        fallen_kg_per_m2=fallen,
    )


def _moved(old_values: _Field, fresh: _Field, old: AirGrid, new: AirGrid, faces: int | None) -> _Field:
    """`old_values` on the new grid. `faces`: the axis across which they are faces' values; None: cells' centres."""
    from scipy.ndimage import gaussian_filter, map_coordinates

    wrapped = old_values
    for axis in (1, 2):
        if faces == axis:  # the last face is the first one again
            wrapped = np.take(wrapped, np.arange(wrapped.shape[axis] - 1), axis=axis)
    ratios = [one / other for one, other in zip(new.cell_m[::-1], old.cell_m[::-1], strict=True)]
    sigma = [0.5 * ratio if ratio > 1 else 0.0 for ratio in ratios]
    smooth = gaussian_filter(wrapped, sigma, mode=("nearest", "wrap", "wrap")) if any(sigma) else wrapped
    places = []
    for axis in range(3):
        shift = 0.0 if faces == axis else 0.5
        at_m = new.low_m[2 - axis] + (np.arange(fresh.shape[axis]) + shift) * new.cell_m[2 - axis]
        place = (at_m - old.low_m[2 - axis]) / old.cell_m[2 - axis] - shift
        places.append(place if axis == 0 else np.mod(place, smooth.shape[axis]))
    around = np.pad(smooth, ((0, 0), (0, 1), (0, 1)), mode="wrap")  # between the last cell and the first
    index = np.meshgrid(*places, indexing="ij")
    out = map_coordinates(around, index, order=1, mode="nearest", prefilter=False)
    if faces:  # the last face is the first one, though the new box may be no multiple of the old
        out[(slice(None),) * faces + (-1,)] = out[(slice(None),) * faces + (0,)]
    ceiling_m = old.low_m[2] + old.size_m[2]
    heights = new.low_m[2] + (np.arange(fresh.shape[0]) + (0.0 if faces == 0 else 0.5)) * new.cell_m[2]
    return np.ascontiguousarray(np.where((heights < ceiling_m)[:, None, None], out, fresh), dtype=np.float32)
