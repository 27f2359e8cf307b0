"""What the modules of a state see of one another: their spheres, the light that is left, and where there is room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import spheres
from forestgen.architecture.modules import Modules
from forestgen.architecture.tables import Tables
from forestgen.community.branch_modules.boxes import NO_BOXES, Boxes
from forestgen.community.branch_modules.crowding import SphereGrid, overlap
from forestgen.community.branch_modules.kinds import Kinds
from forestgen.community.branch_modules.orientation import Turning, orient
from forestgen.community.branch_modules.shade import Shade, ShadowGrid, shade
from forestgen.community.branch_modules.state import State
from forestgen.community.model import Site


@dataclass(frozen=True)
class Surroundings:
    """The spheres of a state's modules, and the light that is left to each."""

    grid: SphereGrid
    shade: Shade | None  # None: plants do not shade what stands below them
    boxes: Boxes
    light: NDArray[np.float32]  # (M,) Q Q_G, 0 to 1: before the species' shade tolerance

    def light_at(self, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) Q_G near the ground at (N, 2) world x and y on the site."""
        return np.ones(len(position_m)) if self.shade is None else self.shade.light_at(position_m)


def boxes_of(site: Site) -> Boxes:
    """The buildings as boxes on the ground."""
    if not site.buildings:
        return NO_BOXES
    position = np.array([one.position_m for one in site.buildings])
    base_m = np.column_stack([position, ground_at(site, position)])
    azimuth = np.array([one.turn_rad for one in site.buildings])
    return Boxes(base_m, np.array([one.size_m for one in site.buildings]), azimuth)


def ground_at(site: Site, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) height of the ground at (N, 2) world x and y, metres."""
    if site.height is None:
        return np.zeros(len(position_m))
    return np.asarray(site.height(position_m[:, 0], position_m[:, 1]), dtype=np.float64)


def surroundings_of(state: State, kinds: Kinds, leaves: NDArray[np.float32]) -> Surroundings:
    """Spheres, crowding (Eq. 1) and global shadow of a state's modules; `leaves` (M,) of a whole module's foliage."""
    parameters, modules, plants = kinds.parameters, state.modules, state.plants
    counts = np.diff(modules.first)
    centre, radius = spheres(kinds.tables, modules, plants.species)
    position = np.repeat(plants.position_m, counts, axis=0)
    position += centre[:, :2]
    ground = np.repeat(plants.ground_m, counts)
    world = np.column_stack([position, ground + centre[:, 2]])
    periodic = parameters.periodic
    grid = SphereGrid.of(world, radius, state.site.size_m if periodic else None)
    boxes = boxes_of(state.site)
    light = overlap(grid, modules.parent_row(), boxes)
    np.exp(np.multiply(light, np.float32(-parameters.crowding), out=light), out=light)
    seen = None
    if parameters.global_shade:
        # The ground below a branch is that at the plant's foot: on a slope a crown keeps its height above its own foot.
        kind = np.repeat(plants.species, counts)
        depth = kinds.traits.opacity[kind] * leaves
        shadows = ShadowGrid(state.site.size_m, cell_m=parameters.cell_m, layer_m=parameters.cell_m, periodic=periodic)
        seen = shade(world, centre[:, 2], radius, depth, shadows, boxes)
        light *= seen.light
    return Surroundings(grid, seen, boxes, light)


def turned(
    around: Surroundings,
    kinds: Kinds,
    after: Modules,
    chosen: NDArray[np.int64],
    state: State,
    former: tuple[NDArray[np.int64], NDArray[np.int64]],
    is_axis: NDArray[np.bool_],
    steps: int,
) -> NDArray[np.float32]:
    """(N, 4) attitudes of the modules in rows `chosen` of `after`, a few steps nearer to their best.

    Parameters
    ----------
    state : at the step's beginning, whose spheres they are turned among.
    former : (N,) each, rows of the modules themselves (-1: just born) and of those that bear them, in that state.
    is_axis : (N,) whether they continue the plant's main axis.
    """
    traits, tables, plants = kinds.traits, kinds.tables, state.plants
    plant = np.searchsorted(after.first, chosen, side="right") - 1
    kind, prototype = plants.species[plant], after.prototype[chosen]
    base = np.column_stack([plants.position_m[plant], plants.ground_m[plant]]) + after.base_m[chosen]
    # The leader goes up: an angle from the vertical is what its branches have.
    angle = np.where(is_axis & (traits.apical_control[kind] > 0.5), 0.0, traits.tropism_angle_rad[kind])
    turning = Turning(
        base_world_m=base,
        rotation=after.rotation[chosen],
        centre_m=_grown(tables)[0][kind, prototype],
        radius_m=_grown(tables)[1][kind, prototype],
        row=former[0],
        parent_row=former[1],
        tropism_angle_rad=angle,
        tropism_weight=traits.tropism_weight[kind],
        collision_weight=traits.collision_weight[kind],
        ground_m=plants.ground_m[plant],
    )
    return orient(around.grid, turning, steps=steps, angle_rad=kinds.parameters.turn_rad, boxes=around.boxes)


def _grown(tables: Tables) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (T, S, 3) and radii (T, S) of grown modules' spheres, module's frame."""
    return tables.sphere_centre_m[:, :, -1], tables.sphere_radius_m[:, :, -1]
