"""The plant types of a simulation as arrays, for compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.plant_type import PlantType
from forestgen.architecture.tables import Tables
from forestgen.community.branch_modules.unknown_names import no_prototype

#: What stands in the arrays for a species that does not grow, such as a building.
STAND_IN = PlantType(life_span_yr=1.0, root_vigour_max=1.0, growth_rate_per_yr=1.0, apical_control=0.5, determinacy=0.5)


@dataclass(frozen=True)
class Traits:
    """Every number of the plant types; arrays (T,) in the order of the species. Fields as in `PlantType`."""

    grows: NDArray[np.bool_]  # whether it is a plant at all; a building's kind never grows
    life_span_yr: NDArray[np.float64]
    root_vigour_max: NDArray[np.float64]
    growth_rate_per_yr: NDArray[np.float64]
    apical_control: NDArray[np.float64]
    determinacy: NDArray[np.float64]
    apical_control_mature: NDArray[np.float64]
    determinacy_mature: NDArray[np.float64]
    flowering_age_yr: NDArray[np.float64]
    flowering_delay_max: NDArray[np.float64]
    tropism_angle_rad: NDArray[np.float64]
    tropism_weight: NDArray[np.float64]
    collision_weight: NDArray[np.float64]
    mature_age: NDArray[np.float64]
    vigour_min: NDArray[np.float64]
    vigour_max: NDArray[np.float64]
    sprouting: NDArray[np.float64]
    disused_share: NDArray[np.float64]
    upkeep: NDArray[np.float64]
    reach_m: NDArray[np.float64]
    compensation: NDArray[np.float64]
    opacity: NDArray[np.float64]
    shade_tolerance: NDArray[np.float64]
    seeds_per_yr: NDArray[np.float64]
    seeding_radius_m: NDArray[np.float64]
    temperature_c: NDArray[np.float64]
    temperature_width_c: NDArray[np.float64]
    precipitation_mm_per_yr: NDArray[np.float64]
    precipitation_width_mm_per_yr: NDArray[np.float64]


def traits_of(types: Sequence[PlantType | None]) -> Traits:
    """The arrays of plant types in the order of the species; None: a species that does not grow."""
    columns = {}
    for name in (one.name for one in fields(Traits) if one.name != "grows"):
        values = []
        for one in types:
            plant_type = STAND_IN if one is None else one
            value = getattr(plant_type, name)
            values.append(getattr(plant_type, name.removesuffix("_mature")) if value is None else value)
        columns[name] = np.array(values, dtype=np.float64)
    angle_rad = columns["tropism_angle_rad"]  # below 0: below the horizontal
    columns["tropism_angle_rad"] = np.where(angle_rad < 0.0, 0.5 * np.pi - angle_rad, angle_rad)
    # As ages are kept: a limit that float32 cannot hold would never be reached.
    columns["mature_age"] = columns["mature_age"].astype(np.float32).astype(np.float64)
    return Traits(grows=np.array([one is not None for one in types], dtype=np.bool_), **columns)


def allowed_prototypes(names: Sequence[str], types: Sequence[PlantType | None]) -> NDArray[np.bool_]:
    """(T, S) which of the prototypes each type may have; a type that names none may have all.

    Raises
    ------
    RecipeError : a name that no prototype has.
    """
    out = np.ones((len(types), len(names)), dtype=np.bool_)
    for row, one in enumerate(types):
        if one is None or not one.prototypes:
            continue
        for name in one.prototypes:
            if name not in names:
                raise no_prototype(name, names)
        out[row] = [name in one.prototypes for name in names]
    return out


def main_path(tables: Tables) -> NDArray[np.bool_]:
    """(S, N) whether the way from a prototype's root to a node takes main children only."""
    out = np.zeros(tables.parent.shape, dtype=np.bool_)
    for s, children in enumerate(tables.first_child):
        node = 0
        while node >= 0:
            out[s, node] = True
            node = int(children[node])
    return out
