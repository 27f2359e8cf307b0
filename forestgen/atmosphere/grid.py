"""What atmosphere, scene and files exchange: fields of clouds, states of the air, and what either must be.

`CloudGrid` is what the scene gets. `Weather` is one state of the air at one time, which simulations make. Both are
checked before they are written and after they are read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.cloud_detail import NO_DETAIL, Detail
from forestgen.core.errors import ResourceError
from forestgen.core.processes import free_bytes

ROUNDING = 1e-6  # by which a simulation's ratios (kg/kg) may be below 0
_CELLS = ("z", "y", "x")
# Field of a snapshot -> (its axes, least, most, unit, name in NetCDF: the standard one if CF's table has one that fits
# exactly); with three axes it has single precision, otherwise double.
FIELDS: dict[str, tuple[tuple[str, ...], float, float, str, str]] = {
    "east_m_per_s": (("z", "y", "x_face"), -500.0, 500.0, "m/s", "eastward_wind"),
    "north_m_per_s": (("z", "y_face", "x"), -500.0, 500.0, "m/s", "northward_wind"),
    "up_m_per_s": (("z_face", "y", "x"), -500.0, 500.0, "m/s", "upward_air_velocity"),
    "potential_temperature_k": (_CELLS, 50.0, 5000.0, "K", "air_potential_temperature"),
    "vapour": (_CELLS, -ROUNDING, 1.0, "kg/kg", "humidity_mixing_ratio"),
    "cloud": (_CELLS, -ROUNDING, 1.0, "kg/kg", "cloud_liquid_water_mixing_ratio"),
    "rain": (_CELLS, -ROUNDING, 1.0, "kg/kg", "mass of rain per mass of dry air"),
    "fallen_kg_per_m2": (("y", "x"), -ROUNDING, np.inf, "kg/m2", "rainfall_amount"),
    "density_kg_per_m3": (("z",), 1e-6, 10.0, "kg/m3", "density of the air at rest"),
    "temperature_ratio": (("z",), 1e-3, 10.0, "", "dimensionless_exner_function"),
}


@dataclass(frozen=True)
class PhaseFunction:
    """How a cloud scatters light: two Henyey-Greenstein lobes, the second usually weak and backwards."""

    forward: float = 0.85  # g of the first lobe, in (-1, 1)
    backward: float = -0.2  # g of the second
    forward_share: float = 1.0  # of the light that is scattered, [0, 1]

    @property
    def asymmetry(self) -> float:
        """Mean cosine of the scattering angle."""
        return self.forward_share * self.forward + (1.0 - self.forward_share) * self.backward


@dataclass(frozen=True)
class CloudGrid:
    """Extinction on a regular grid of cell values over a box; nothing outside it. Grey: the same at all wavelengths."""

    extinction_per_m: NDArray[np.float32]  # (Z, Y, X)
    low_m: tuple[float, float, float]  # world corner of the first cell
    high_m: tuple[float, float, float]  # world corner after the last cell
    albedo: float = 0.999
    phase: PhaseFunction = PhaseFunction()
    full_per_m: NDArray[np.float32] | None = None  # (Z, Y, X) with detail: of the clouds' inside, without the air
    detail: Detail = NO_DETAIL  # within the cells
    above: CloudGrid | None = None  # another layer, of other particles, higher than all of this one

    @property
    def layers(self) -> tuple[CloudGrid, ...]:
        """This one and those above."""
        return (self,) if self.above is None else (self, *self.above.layers)

    @property
    def inside_per_m(self) -> NDArray[np.float32]:
        """(Z, Y, X) what the detail's shares multiply."""
        return self.extinction_per_m if self.full_per_m is None else self.full_per_m

    @property
    def cell_m(self) -> tuple[float, float, float]:
        """Size of a cell along x, y and z."""
        x, y, z = (
            float(high - low) / count
            for low, high, count in zip(self.low_m, self.high_m, self.extinction_per_m.shape[::-1], strict=True)
        )
        return x, y, z


@dataclass(frozen=True)
class AirGrid:
    """Equal cells over a box. Arrays are (Z, Y, X): layers from the ground up, rows along y, columns along x."""

    cells: tuple[int, int, int]  # along x, y, z
    cell_m: tuple[float, float, float]  # their size
    low_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world corner of the first cell; z is the datum's height
    periodic: bool = True  # at the sides; otherwise wind blows in and out

    @property
    def shape(self) -> tuple[int, int, int]:
        """(Z, Y, X) of an array of cell values."""
        return self.cells[::-1]

    @property
    def size_m(self) -> tuple[float, float, float]:
        x, y, z = (count * side for count, side in zip(self.cells, self.cell_m, strict=True))
        return x, y, z

    @property
    def layer_heights_m(self) -> NDArray[np.float64]:
        """(Z,) height of the cells' centres above the datum."""
        return np.asarray(self.low_m[2] + (np.arange(self.cells[2]) + 0.5) * self.cell_m[2])


@dataclass(frozen=True)
class Weather:
    """A snapshot. Ratios are mass of water per mass of dry air."""

    grid: AirGrid
    time_s: float  # since the simulation began
    east_m_per_s: NDArray[np.float32]  # (Z, Y, X + 1) at west and east faces; periodic: the last is the first
    north_m_per_s: NDArray[np.float32]  # (Z, Y + 1, X) at south and north faces
    up_m_per_s: NDArray[np.float32]  # (Z + 1, Y, X) at bottoms and tops
    potential_temperature_k: NDArray[np.float32]  # (Z, Y, X)
    vapour: NDArray[np.float32]  # (Z, Y, X) kg/kg
    cloud: NDArray[np.float32]  # (Z, Y, X) kg/kg of droplets that float
    rain: NDArray[np.float32]  # (Z, Y, X) kg/kg of drops that fall
    fallen_kg_per_m2: NDArray[np.float64]  # (Y, X) rain on the ground since the beginning: mm
    density_kg_per_m3: NDArray[np.float64]  # (Z,) of the air at rest, in each layer
    temperature_ratio: NDArray[np.float64]  # (Z,) of temperature to potential temperature: Exner's function
    solid: NDArray[np.bool_] | None = None  # (Z, Y, X) cells inside the terrain; None: flat

    @property
    def cloud_water_kg_per_m3(self) -> NDArray[np.float32]:
        """(Z, Y, X) liquid water content of droplets."""
        return self.cloud * self.density_kg_per_m3.astype(np.float32)[:, None, None]

    @property
    def rain_water_kg_per_m3(self) -> NDArray[np.float32]:
        """(Z, Y, X) liquid water content of drops."""
        return self.rain * self.density_kg_per_m3.astype(np.float32)[:, None, None]

    @property
    def total_water_kg(self) -> float:
        """Vapour, droplets, drops and what has fallen. The flow has the lowest layer's density (`fluid.parameters`)."""
        area_m2 = self.grid.cell_m[0] * self.grid.cell_m[1]
        ratios = (ratio.astype(np.float64) for ratio in (self.vapour, self.cloud, self.rain))
        ratio = sum(float((one if self.solid is None else np.where(self.solid, 0.0, one)).sum()) for one in ratios)
        mass_kg = area_m2 * self.grid.cell_m[2] * float(self.density_kg_per_m3[0])
        return mass_kg * ratio + area_m2 * float(self.fallen_kg_per_m2.sum())


class FieldError(ValueError):
    """A field, `what`, is not what it should be: `expected` and `got` in words; `level` is a sounding's, by index."""

    def __init__(self, what: str, expected: str, got: str, level: int | None = None) -> None:
        self.what, self.expected, self.got, self.level = what, expected, got, level
        super().__init__(f"{what}: expected {expected}, got {got}")


def check_weather(weather: Weather) -> None:
    """Raise `FieldError` for sizes that do not fit the grid, other precisions, or values out of all weather."""
    grid = weather.grid
    check_air_grid(grid)
    if not (np.isfinite(weather.time_s) and weather.time_s >= 0.0):
        raise FieldError("time", "seconds since the beginning", f"{weather.time_s:g} s")
    sizes = dict(zip(_CELLS, grid.shape, strict=True))
    sizes |= {f"{axis}_face": count + 1 for axis, count in sizes.items()}
    for name, (axes, least, most, unit, _) in FIELDS.items():
        kind = np.float32 if len(axes) == 3 else np.float64
        _check_array(name, getattr(weather, name), tuple(sizes[axis] for axis in axes), kind)
        _check_range(name, getattr(weather, name), least, most, unit)
    if weather.solid is not None:
        _check_array("solid", weather.solid, grid.shape, np.bool_)


def check_air_grid(grid: AirGrid) -> None:
    """Raise `FieldError` where a grid's cells are none."""
    if not all(n >= 1 for n in grid.cells):
        raise FieldError("cells", "three numbers of at least 1", str(tuple(grid.cells)))
    if not all(np.isfinite(side) and side > 0.0 for side in grid.cell_m):
        raise FieldError("size of the cells", "three lengths above 0", f"{tuple(grid.cell_m)} m")
    if not np.isfinite(grid.low_m).all():
        raise FieldError("corner of the box", "three numbers", f"{tuple(grid.low_m)} m")


def check_clouds(grid: CloudGrid) -> None:
    """Raise `FieldError` for no cells, another precision, values that are no numbers or negative, a flat box."""
    field = grid.extinction_per_m
    if field.ndim != 3 or field.size == 0:
        raise FieldError("extinction", "an array of three dimensions (Z, Y, X), all at least 1", str(field.shape))
    _check_array("extinction", field, field.shape, np.float32)
    _check_range("extinction", field, 0.0, float(np.finfo(np.float32).max), "1/m")
    for axis, low, high in zip("xyz", grid.low_m, grid.high_m, strict=True):
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise FieldError(f"the box along {axis}", "a lower corner below the upper one", f"{low:g} to {high:g} m")
    if not 0.0 <= grid.albedo <= 1.0:
        raise FieldError("albedo", "0 to 1", f"{grid.albedo:g}")
    phase = grid.phase
    if not (abs(phase.forward) < 1.0 and abs(phase.backward) < 1.0 and 0.0 <= phase.forward_share <= 1.0):
        got = f"lobes of {phase.forward:g} and {phase.backward:g}, a share of {phase.forward_share:g}"
        raise FieldError("phase function", "lobes between -1 and 1, a share of 0 to 1", got)


def check_room(byte_count: int, where: str) -> None:
    """Raise `ResourceError` for a file whose fields would take more than half of the memory that is free."""
    free = free_bytes()
    if byte_count > free / 2:
        expected, got = f"at most half of the {free / 1e9:.1f} GB that are free", f"{byte_count / 1e9:,.1f} GB"
        raise ResourceError("the file's fields do not fit into memory", where=where, expected=expected, got=got)


def _check_array(name: str, values: NDArray[Any], shape: tuple[int, ...], kind: type[np.generic]) -> None:
    if values.dtype != kind:
        raise FieldError(name, f"{np.dtype(kind)} numbers", str(values.dtype))
    if values.shape != shape:
        raise FieldError(name, f"an array of {shape}", str(values.shape))


def _check_range(name: str, values: NDArray[Any], least: float, most: float, unit: str) -> None:
    # A NaN makes both NaN, and so fails.
    low, high = float(values.min()), float(values.max())
    if low >= least and high <= most:
        return
    if not np.isfinite(values).all():
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(values))[0])
        raise FieldError(name, "numbers everywhere", f"{values[where]} at {where}")
    bad = low if low < least else high
    where = tuple(int(k) for k in np.argwhere(values == bad)[0])
    bounds = f"nothing below {max(least, 0.0) if least > -1.0 else least:g}" if low < least else f"at most {most:g}"
    raise FieldError(name, f"{bounds} {unit}".strip(), f"{bad:g} {unit} at {where}".replace("  ", " "))
