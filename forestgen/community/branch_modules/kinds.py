"""What holds in a step: the parameters, plant types and tables, with all changes up to then."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.plant_type import PlantType
from forestgen.architecture.prototype import Prototype
from forestgen.architecture.tables import Tables, tables_of
from forestgen.community.branch_modules.changes import parameters_at
from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.branch_modules.state import State
from forestgen.community.branch_modules.traits import STAND_IN, Traits, allowed_prototypes, main_path, traits_of


@dataclass(frozen=True)
class Kinds:
    """Parameters, types and prototypes of one step."""

    parameters: BranchModulesParameters
    traits: Traits
    tables: Tables
    main_path: NDArray[np.bool_]  # (S, N) of `traits.main_path`
    allowed: NDArray[np.bool_]  # (T, S) of `traits.allowed_prototypes`


def kinds_at(state: State) -> Kinds:
    """What the step after a state goes by."""
    parameters, types = parameters_at(state.parameters, state.types, state.step)
    traits, tables, path, allowed = _arrays(
        _Same(state.prototypes), tuple(types.get(one.name) for one in state.species), parameters.sphere_scale
    )
    return Kinds(parameters, traits, tables, path, allowed)


class _Same(tuple[Prototype, ...]):
    """Prototypes, which hold arrays, as a key: the same objects are equal."""

    def __hash__(self) -> int:
        return hash(tuple(map(id, self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and tuple(map(id, self)) == tuple(map(id, other))


@lru_cache(maxsize=16)
def _arrays(
    prototypes: _Same, types: tuple[PlantType | None, ...], sphere_scale: float
) -> tuple[Traits, Tables, NDArray[np.bool_], NDArray[np.bool_]]:
    tables = tables_of(prototypes, [one or STAND_IN for one in types], sphere_scale=sphere_scale)
    return traits_of(types), tables, main_path(tables), allowed_prototypes(tables.names, types)
