"""Checks that a snapshot from a file can be one of a simulation: compiled loops use its values as indices.

Here are the checks for plants of any model; each model checks its own columns and its own state
(`CommunityModel.check_snapshot`), by `check_columns`, `check_whole` and `ImpossibleValueError`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Ecologies, Population, Site, Status

_MOST_IDS = 2**32  # one more than the largest
_ROUNDING = 1e-9  # of a radius, over what its species may have
_DEEPEST = 20  # lists in lists of a state


class ImpossibleValueError(ValueError):
    """A value that no simulation gives; who catches it adds the file's name and the step.

    `where` is a column and a plant, or a key of the state.
    """

    def __init__(self, where: str, expected: str, got: str) -> None:
        super().__init__(f"{where}: expected {expected}, got {got}")
        self.where, self.expected, self.got = where, expected, got


@dataclass(frozen=True)
class Limits:
    """What a column may hold."""

    dtype: str  # as NumPy writes it: f8, u4
    least: float = -math.inf
    most: float = math.inf
    finite: bool = True
    nan: bool = False  # whether a plant may lack the value


def check_snapshot(population: Population, site: Site, species: Ecologies) -> None:
    """Raise `ImpossibleValueError` unless a snapshot's own columns can be those of a community of any model.

    `plant_id` is checked by `Population` itself.
    """
    names = tuple(one.name for one in species)
    if population.species_names != names:
        got = ", ".join(map(str, population.species_names)) or "none"
        raise ImpossibleValueError("species_names", ", ".join(names) or "none", got)
    width_m, depth_m = site.size_m
    x_m, y_m, z_m = population.position_m.T
    _check("species", population.species, Limits("u2", 0, len(names) - 1), population)
    _check("x_m", x_m, Limits("f8", 0, width_m), population)
    _check("y_m", y_m, Limits("f8", 0, depth_m), population)
    _check("z_m", z_m, Limits("f8", 0, 0), population)
    _check("radius_m", population.radius_m, Limits("f8", np.nextafter(0, 1)), population)
    _check("height_m", population.height_m, Limits("f8", 0), population)
    _check("age_yr", population.age_yr, Limits("f8", 0), population)
    _check("status", population.status, Limits("u1", 0, max(Status)), population)
    largest = int(population.plant_id[-1]) if len(population) else 0
    check_whole(population.state, "next_id", largest + 1, _MOST_IDS)
    notes = population.state.get("notes", [])
    if not (isinstance(notes, list) and all(isinstance(one, str) for one in notes)):
        raise ImpossibleValueError("notes", "a list of texts", _shown(notes))


def check_columns(population: Population, limits: Mapping[str, Limits]) -> None:
    """Raise `ImpossibleValueError` unless a model's columns are there and within their limits.

    The contract's own columns age_yr and status may be limited further.
    """
    for name, one in limits.items():
        is_own = name not in ("age_yr", "status")
        values = population.columns.get(name) if is_own else getattr(population, name)
        called = f"model.{name}" if is_own else name  # as in the file
        if values is None:
            raise ImpossibleValueError(f"column {called}", "such a column", "none")
        _check(called, values, one, population)


def arrival_limits(population: Population, step_yr: float, *, dead: bool = False) -> dict[str, Limits]:
    """Limits of ages, which give the step of arrival, and of the status in models that keep the `dead` or not."""
    return {
        "age_yr": Limits("f8", 0, (population.step + 0.5) * step_yr),
        "status": Limits("u1", 0, Status.DEAD if dead else Status.MATURE),
    }


def check_radii(population: Population, species: Ecologies) -> None:
    """Raise `ImpossibleValueError` for a plant that is larger than its species can be."""
    largest = np.array([one.max_radius_m for one in species], dtype=np.float64)[population.species]
    wrong = np.flatnonzero(population.radius_m > largest * (1 + _ROUNDING))
    if len(wrong):
        row = int(wrong[0])
        expected = f"at most {largest[row]:g}, its species' max_radius_m"
        raise ImpossibleValueError(place_of("radius_m", population, row), expected, _shown(population.radius_m[row]))


def check_whole(values: Mapping[str, Any], key: str, least: int, most: int) -> None:
    """Raise `ImpossibleValueError` unless a key of the state is a whole number from `least` to `most`."""
    value = values.get(key)
    if not (type(value) is int and least <= value <= most):
        raise ImpossibleValueError(key, f"a whole number from {least} to {most}", _shown(value))


def check_number(values: Mapping[str, Any], key: str, least: float, most: float, *, within: str = "") -> None:
    """Raise `ImpossibleValueError` unless a key of the state, or of a table `within` it, is a number of a range."""
    value: Any = values.get(key)
    key = f"{within}.{key}" if within else key
    if type(value) not in (int, float) or not least <= value <= most:
        raise ImpossibleValueError(key, f"a number from {least:g} to {most:g}", _shown(value))


def check_finite(value: Any, key: str, depth: int = 0) -> None:
    """Raise `ImpossibleValueError` unless all numbers of what is plain as in JSON are finite."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ImpossibleValueError(key, "a finite number", str(value))
    if depth > _DEEPEST:
        raise ImpossibleValueError(key, f"lists and tables at most {_DEEPEST} deep", "more")
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for name, one in inner:
        check_finite(one, f"{key}.{name}", depth + 1)


def place_of(column: str, population: Population, row: int) -> str:
    """Column and plant, as messages name them."""
    return f"column {column} of plant {population.plant_id[row]}"


def _check(name: str, values: NDArray[Any], limits: Limits, population: Population) -> None:
    """Raise `ImpossibleValueError` unless (N,) values are of the type and within the limits."""
    if values.dtype != np.dtype(limits.dtype):
        raise ImpossibleValueError(f"column {name}", f"values of type {np.dtype(limits.dtype)}", str(values.dtype))
    fine = (values >= limits.least) & (values <= limits.most)
    if limits.finite:
        fine &= np.isfinite(values)
    if limits.nan:
        fine |= np.isnan(values)
    wrong = np.flatnonzero(~fine)
    if len(wrong):
        row = int(wrong[0])
        raise ImpossibleValueError(place_of(name, population, row), _range(limits), _shown(values[row]))


def _range(limits: Limits) -> str:
    if math.isinf(limits.most):
        return "a finite number" if math.isinf(limits.least) else f"a finite number, at least {limits.least:g}"
    return f"{limits.least:g}" if limits.least == limits.most else f"{limits.least:g} to {limits.most:g}"


def _shown(value: Any) -> str:
    return "nothing" if value is None else f"{value!s:.80}"
