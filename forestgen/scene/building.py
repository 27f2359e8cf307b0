"""Buildings in a scene: what a kind of building is, its geometry and its materials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Generic, TypeVar

import numpy as np

from forestgen.community.population import Population
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.recipe.registries import BUILDINGS
from forestgen.recipe.species import Building, Material
from forestgen.scene.exemplar_plan import ExemplarPlan

KeysT = TypeVar("KeysT", bound=Building)


class BuildingKind(Generic[KeysT]):
    """A kind of building: its keys in recipes, materials and surfaces.

    Nothing of it is random. Cameras inside are refused by its box alone, of the keys' `size_m`: walls stand at most a
    tenth of the smaller side inside of the ground plan, and a roof falls by at most half of the height.
    """

    Parameters: type[KeysT]
    materials: Mapping[str, Material]  # of its parts, by name

    def meshes(self, keys: KeysT) -> dict[str, Mesh]:
        """Closed surfaces of its parts, by name: origin in the middle of the ground plan, x along the width, z up."""
        raise NotImplementedError


def exemplar_of(building: Building, radius_m: float) -> Exemplar:
    """The geometry of a building; `radius_m` is that of its row in the population."""
    kind: BuildingKind[Any] = BUILDINGS.load(building.kind)
    width, depth, height = building.size_m
    own = _own_materials(building)
    meshes = kind.meshes(building).items()
    return Exemplar(
        species=building.kind,
        organs=tuple(OrganMesh(Part.STRUCTURE, own.get(part, part), mesh) for part, mesh in meshes),
        radius_m=radius_m,
        height_m=height,
        crown_width_m=0.5 * (width + depth),
        leaf_area_m2=0.0,
        wood_volume_m3=0.0,
    )


def building_materials(buildings: Iterable[Building]) -> dict[tuple[str, str], Material]:
    """Materials of buildings by (kind, material)."""
    found: dict[tuple[str, str], Material] = {}
    for one in buildings:
        found |= {(one.kind, part): material for part, material in BUILDINGS.load(one.kind).materials.items()}
        found |= {(one.kind, name): one.materials[part] for part, name in _own_materials(one).items()}
    return found


def _own_materials(building: Building) -> dict[str, str]:
    """Part -> name of the building's own material of it, which tells it from those of others of its kind."""
    x, y = building.position_m
    return {part: f"{part} at {x:g}, {y:g}" for part in building.materials}


def plan_buildings(buildings: Mapping[int, Building], population: Population) -> dict[int, ExemplarPlan]:
    """Exemplars of each kind, by its index among the population's species: one for equal buildings.

    `buildings`: by row of the population.
    """
    plans = {}
    for index in np.unique(population.species[list(buildings)]) if buildings else ():
        rows = np.flatnonzero(population.species == index)
        forms = [_form(buildings[int(row)]) for row in rows]
        distinct = sorted(set(forms))
        label = np.array([distinct.index(form) for form in forms])
        first = rows[[forms.index(form) for form in distinct]]
        plans[int(index)] = ExemplarPlan.of_species(int(index), population.radius_m[first], label, plant=first)
    return plans


def _form(building: Building) -> tuple[tuple[float, ...], str]:
    """What two buildings have in common whose geometry and materials are the same."""
    left_out = {"size_m"} if building.materials else {"size_m", "position_m", "azimuth_deg"}
    return building.size_m, repr(sorted(building.model_dump(exclude=left_out).items()))
