"""From simulated water to what the renderer gets: extinction, albedo and phase function on a grid.

Droplets
    sigma_t = 3 w / (2 rho_w r_eff), w the mass of liquid water in a cubic metre of air, rho_w = 1000 kg/m³: the
    geometric limit, extinction efficiency 2; Mie's is 2.07 to 2.1 for these droplets (5% more, left out: r_eff is not
    known so well). The simulation has one moment, mass; so r_eff is one number by type of cloud: see
    `forestgen.atmosphere.clouds.simulated`. Ice is not simulated: an anvil is of droplets here, and has no halo.
Rain
    Marshall and Palmer's drops, N(D) = N_0 exp(-L D), N_0 = 8e6 /m⁴. Mass fixes L = (pi rho_w N_0 / w)^(1/4), and
    sigma_t = pi N_0 / L³, which is the formula above with r_eff = 3 / (2 L): 0.38 mm at 0.1 g/m³, 0.67 mm at 1 g/m³.
    So a gram of rain dims some 60 times less than a gram of cloud, and it takes long shafts to be seen.
Albedo
    Mie's 1 - albedo at 550 nm is 2e-7 to 8e-7 for droplets and about 2e-5 for rain: nothing, even for the hundreds of
    times that a path scatters in a thick cloud. `ALBEDO` holds for both; 0.999 would lose 5% and more there. Clouds
    are grey: beyond 1300 nm, where water absorbs (1 - albedo about 5e-3 at 1600 nm), real ones are darker.
Phase function
    Two Henyey-Greenstein lobes fitted to Mie's for a gamma distribution of droplets (effective variance 0.1, 550 nm).
    Asymmetry parameter and backward share are exact; docs/spectra/make_droplets.py prints these numbers and the error
    by angle. Lost are the diffraction peak (47% of the light within 5 degrees; the lobes have 18%), rainbow and glory.
    Rain is given the same lobes.
Thin air
    Extinction below `THINNEST_PER_M` becomes zero, so that the transport can skip the air: along a whole kilometre of
    it, 1% of the light is lost. Where that would take more than 0.1% of the field's extinction, less is cut.

References
----------
Hansen and Travis 1974 (Space Science Reviews 16, 527-610): effective radius and variance. Hess, Koepke and Schult 1998
(Bulletin of the AMS 79, 831-844). Miles, Verlinde and Clothiaux 2000 (Journal of the Atmospheric Sciences 57, 295-311).
Martin, Johnson and Spice 1994 (ibid. 51, 1823-1842). Rosenfeld and Lensky 1998 (Bulletin of the AMS 79, 2457-2476).
Marshall and Palmer 1948 (Journal of Meteorology 5, 165-166).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.billows import detail_of
from forestgen.atmosphere.grid import AirGrid, CloudGrid, PhaseFunction, Weather
from forestgen.core.errors import RecipeError

ALBEDO = 0.999999
KOSCHMIEDER = 3.912  # -log of the contrast 0.02: extinction times the distance at which a black thing is just seen
THINNEST_PER_M = 1e-5
MOST_CUT = 1e-3  # share of the field's extinction that may be cut with thin air
_WATER_KG_PER_M3 = 1000.0
_MARSHALL_PALMER_PER_M4 = 8e6
_RADII_UM = (1.0, 1000.0)  # that anybody may ask for
_MOST_CELLS = 400_000_000  # of a tiled grid: 1.6 GB
# By effective radius, µm: g of the lobes and share of the first; printed by docs/spectra/make_droplets.py.
_LOBES = np.array([
    [5.0, 0.8705, -0.7222, 0.9868],
    [8.0, 0.8778, -0.7192, 0.9887],
    [10.0, 0.8800, -0.7188, 0.9901],
    [15.0, 0.8836, -0.7152, 0.9914],
    [20.0, 0.8856, -0.7136, 0.9921],
])  # fmt: skip


def droplet_extinction(water_kg_per_m3: NDArray[np.floating], radius_um: float) -> NDArray[np.float32]:
    """Extinction per metre of cloud droplets, of the shape given."""
    return np.asarray(water_kg_per_m3 * (1.5 / (_WATER_KG_PER_M3 * radius_um * 1e-6)), dtype=np.float32)


def rain_extinction(water_kg_per_m3: NDArray[np.floating]) -> NDArray[np.float32]:
    """Extinction per metre of Marshall and Palmer's raindrops, of the shape given."""
    scale = (np.pi * _MARSHALL_PALMER_PER_M4) ** 0.25 / _WATER_KG_PER_M3**0.75
    return np.asarray(scale * np.maximum(water_kg_per_m3, 0.0) ** 0.75, dtype=np.float32)


def droplet_phase(radius_um: float) -> PhaseFunction:
    """The fitted lobes of droplets of an effective radius; between those that were fitted, and no further."""
    radii = _LOBES[:, 0]
    forward, backward, share = (float(np.interp(radius_um, radii, column)) for column in _LOBES[:, 1:].T)
    return PhaseFunction(forward, backward, share)


def cloud_grid_of(
    weather: Weather,
    *,
    centre_m: tuple[float, float] | None,
    droplet_radius_um: float,
    tiles: int = 1,
    detailed: bool = False,
) -> CloudGrid | None:
    """The clouds and rain of a snapshot as the renderer gets them; None where there are none.

    Raises `RecipeError` for another radius than droplets have, or too many cells.

    Parameters
    ----------
    centre_m : world x and y of the middle of the field; None: where the weather's own grid lies, as over terrain.
    droplet_radius_um : effective radius.
    tiles : copies of a periodic field side by side, along x and along y.
    detailed : with edges and billows within the cells; see `forestgen.atmosphere.billows`.
    """
    low_um, high_um = _RADII_UM
    if not low_um <= droplet_radius_um <= high_um:
        expected = f"micrometres from {low_um:g} to {high_um:g}"
        raise RecipeError("no radius of droplets", where="sky.clouds", expected=expected, got=f"{droplet_radius_um:g}")
    cells = math.prod(weather.grid.cells) * tiles**2
    if cells > _MOST_CELLS:
        expected = f"at most {_MOST_CELLS:,}"
        raise RecipeError("too many cells of cloud", where="sky.clouds", expected=expected, got=f"{cells:,}")
    cloud, rain = weather.cloud_water_kg_per_m3, weather.rain_water_kg_per_m3
    if weather.solid is not None:
        cloud, rain = (np.where(weather.solid, np.float32(0), water) for water in (cloud, rain))
    # Rounding may leave water slightly below 0.
    extinction = droplet_extinction(np.maximum(cloud, np.float32(0)), droplet_radius_um) + rain_extinction(rain)
    if weather.solid is not None:
        extinction = down_to_the_ground(extinction, weather.solid)
    extinction, _ = without_thin_air(extinction)
    layers = np.flatnonzero(extinction.any(axis=(1, 2)))
    if not len(layers):
        return None
    # An empty layer stays on either side: the renderer interpolates towards it, and holds a border's values outwards.
    first, last = max(int(layers[0]) - 1, 0), min(int(layers[-1]) + 2, len(extinction))
    extinction, copies = extinction[first:last], (1, tiles, tiles)
    low, high = _corners(weather.grid, centre_m, tiles, first, last)
    phase = droplet_phase(droplet_radius_um)
    grid = CloudGrid(np.ascontiguousarray(np.tile(extinction, copies)), low, high, ALBEDO, phase)
    if not detailed:
        return grid
    rainy = rain_extinction(rain[first:last]) > 0.5 * extinction
    full, detail = detail_of(extinction, rainy, weather.grid.cell_m, periodic=tiles > 1)
    brick = np.ascontiguousarray(np.tile(detail.brick, copies))
    return replace(grid, full_per_m=np.ascontiguousarray(np.tile(full, copies)), detail=detail._replace(brick=brick))


def without_thin_air(extinction: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """The same with thin air cut to zero, and the share of all extinction that went with it; see the module."""
    total = float(extinction.sum(dtype=np.float64))
    thin = extinction < THINNEST_PER_M
    if total == 0.0:
        return extinction, 0.0
    lost = float(extinction[thin].sum(dtype=np.float64)) / total
    if lost > MOST_CUT:
        values = np.sort(extinction[thin & (extinction > 0)])
        allowed = int(np.searchsorted(np.cumsum(values, dtype=np.float64), MOST_CUT * total, "right"))
        thin = extinction < values[allowed]
        lost = float(extinction[thin].sum(dtype=np.float64)) / total
    return np.where(thin, np.float32(0), extinction), lost


def down_to_the_ground(extinction: NDArray[np.float32], solid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Extinction (Z, Y, X) with that of the lowest air repeated in the two cells below it, inside the terrain.

    The ground is finer than the cells: without this, fog would end half a cell above it.
    """
    out = extinction.copy()
    for _ in range(2):
        out[:-1] = np.where(solid[:-1] & (out[:-1] == 0), out[1:], out[:-1])
    return out


def _corners(
    grid: AirGrid, centre_m: tuple[float, float] | None, tiles: int, first: int, last: int
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Corners of the tiled field, layers `first` to before `last`."""
    x, y = (low + size / 2 for low, size in zip(grid.low_m[:2], grid.size_m[:2], strict=True))
    if centre_m is not None:
        x, y = centre_m
    half_x, half_y = (tiles * size / 2 for size in grid.size_m[:2])
    bottom, layer = grid.low_m[2], grid.cell_m[2]
    low = (x - half_x, y - half_y, bottom + first * layer)
    return low, (x + half_x, y + half_y, bottom + last * layer)
