"""What a snapshot of weather and an extinction field must be, before they are written and after they are read."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.weather import AirGrid, Weather
from forestgen.core.errors import ResourceError
from forestgen.core.processes import free_bytes

ROUNDING = 1e-6  # by which a simulation's ratios (kg/kg) may be below 0

# field -> (shape in terms of the grid's Z, Y, X, what each axis adds), least, most, unit
_FIELDS: dict[str, tuple[tuple[int, ...], float, float, str]] = {
    "east_m_per_s": ((0, 0, 1), -500.0, 500.0, "m/s"),
    "north_m_per_s": ((0, 1, 0), -500.0, 500.0, "m/s"),
    "up_m_per_s": ((1, 0, 0), -500.0, 500.0, "m/s"),
    "potential_temperature_k": ((0, 0, 0), 50.0, 5000.0, "K"),
    "vapour": ((0, 0, 0), -ROUNDING, 1.0, "kg/kg"),
    "cloud": ((0, 0, 0), -ROUNDING, 1.0, "kg/kg"),
    "rain": ((0, 0, 0), -ROUNDING, 1.0, "kg/kg"),
}


class FieldError(ValueError):
    """A field cannot be what it should be.

    Parameters
    ----------
    what : the quantity. expected, got : in words.
    """

    def __init__(self, what: str, expected: str, got: str) -> None:
        self.what, self.expected, self.got = what, expected, got
        super().__init__(f"{what}: expected {expected}, got {got}")


def check_weather(weather: Weather) -> None:
    """Refuse a snapshot that no simulation could go on from.

    Raises
    ------
    FieldError : sizes that do not fit the grid, other precisions, values that are no numbers or out of all weather.
    """
    check_air_grid(weather.grid)
    shape = weather.grid.shape
    if not (np.isfinite(weather.time_s) and weather.time_s >= 0.0):
        raise FieldError("time", "seconds since the beginning", f"{weather.time_s:g} s")
    for name, (more, least, most, unit) in _FIELDS.items():
        wanted = tuple(n + k for n, k in zip(shape, more, strict=True))
        _check_array(name, getattr(weather, name), wanted, np.float32)
        _check_range(name, getattr(weather, name), least, most, unit)
    for name, wanted, least, most, unit in (
        ("fallen_kg_per_m2", shape[1:], -ROUNDING, np.inf, "kg/m2"),
        ("density_kg_per_m3", shape[:1], 1e-6, 10.0, "kg/m3"),
        ("temperature_ratio", shape[:1], 1e-3, 10.0, ""),
    ):
        _check_array(name, getattr(weather, name), wanted, np.float64)
        _check_range(name, getattr(weather, name), least, most, unit)
    if weather.solid is not None:
        _check_array("solid", weather.solid, shape, np.bool_)


def check_air_grid(grid: AirGrid) -> None:
    """Raise FieldError where a grid's cells are none."""
    if len(grid.cells) != 3 or not all(n >= 1 for n in grid.cells):
        raise FieldError("cells", "three numbers of at least 1", str(tuple(grid.cells)))
    if len(grid.cell_m) != 3 or not all(np.isfinite(side) and side > 0.0 for side in grid.cell_m):
        raise FieldError("size of the cells", "three lengths above 0", f"{tuple(grid.cell_m)} m")
    if len(grid.low_m) != 3 or not all(np.isfinite(side) for side in grid.low_m):
        raise FieldError("corner of the box", "three numbers", f"{tuple(grid.low_m)} m")


def check_clouds(grid: CloudGrid) -> None:
    """Refuse a field that no light could pass through.

    Raises
    ------
    FieldError : no cells, another precision, values that are no numbers or negative, a box without volume.
    """
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
    """Refuse, before it is read, what would not fit into memory.

    Raises
    ------
    ResourceError : it takes more than half of what is free.
    """
    free = free_bytes()
    if byte_count > free / 2:
        raise ResourceError(
            "the file's fields do not fit into memory",
            where=where,
            expected=f"at most half of the {free / 1e9:.1f} GB that are free",
            got=f"{byte_count / 1e9:,.1f} GB",
        )


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
