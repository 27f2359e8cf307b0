"""Plants placed from a density, one by one, each of which deforms the density for those that follow.

Every species i has a field f_i(x, y) over the site: the density of its next plant. A plant is drawn from the field of
its species by inverse transformation, of the sums over rows and then along a row. Then it multiplies the fields by
its kernels::

    f_i(x, y) <- f_i(x, y) κ_ij(d / r)        d: distance from the plant, of species j and radius r

κ below 1 keeps plants away, 1 changes nothing, above 1 invites. Fields need no normalization: their sums are known.
Plants come largest first, so that large, old plants decide where small, young ones stand. A step of Δt years makes
plants older and nothing else.

Parameters: see below; f_i is a species' map times its conditions, r its radius_m. A species'
radii are at most its max_radius_m; heights follow from its height_m.

Recipe::

    community:
      model: deformation_kernel
      plants:
        spruce: {plants_per_ha: 900, radius_m: {median: 1.4, sigma: 0.3}, map: [[0.2, 1], [1, 0.2]]}
        birch: {count: 200}
      kernels:
        spruce: inhibition                     # of spruces on every species
        birch:                                 # of birches
          birch: clustering                    # on birches
          spruce: {curve: [[0, 0], [0.5, 0], [0.9, 1]]}

    community:
      model: deformation_kernel
      plants: {spruce: {count: 1000}}
      kernels: {hopkins: 1.6}                  # how clustered; the kernel is found

Kernels
-------
``curve`` gives κ by distance, as a number, control points, {smooth: points} or a {formula: text} of x. Distances are
in radii of the plant that acts, or metres with ``distance: metres``. Beyond ``reach`` κ is 1; reach is that of the
last point unless it is given. ``balanced: true`` scales each plant's kernel so that the field's sum within reach
stays what it was.

Four kernels have names; distances are in radii, and H is that of 100 equal plants with a radius of 0.75 spacings. A
spacing is the root of the area that a plant has.

=================  ============================================  ====
name               points                                        H
=================  ============================================  ====
inhibition         (0, 0) (1, 0) (1.1, 1)                        0.47
neutral            1 everywhere                                  1.0
weak_clustering    (0, 0) (0.2, 0) (0.4, 1.9) (1.2, 0.6) (3, 1)  1.2
clustering         (0, 0) (0.2, 0) (0.3, 3.6) (1.2, 0.5) (3, 1)  2.4
=================  ============================================  ====

The clustering ones invite close by and keep away farther out, so that clusters stay apart: their H does not depend on
the number of plants (``clustering``: 2.4 of 100 and of 1,600, with deviations between seeds of 0.3 and 0.04). A kernel
that only invites feeds on itself, up to one heap of all plants, and its H grows with the number.

The kernel matrix is given by the species that acts, and within that by the species that is affected: the entry
``kernels: {j: {i: ...}}`` is M_ij of the reference, the effect of species j on the field f_i. What is left out is
neutral.

References
----------
B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002, chapter 5: equation 5.1,
Algorithms 5.1 and 5.2, Figures 5.1 to 5.9.

Decisions
---------
- Algorithm 5.1 as printed draws a plant's y between rows k and k + 1 but its x from a mixture of both rows, while its
  sums are those of cells: that shifts plants by half a cell and blurs maps by one. Here the density is constant in a
  cell, and y and x are drawn from that. R_0 must begin as 0 and then take up row 0; Algorithm 5.2's ΔR is carried
  down over all rows.
- The thesis shows its kernels as small drawings without numbers. The named ones are ours: inhibition bars a plant's
  own radius, as in Figure 5.1; the clustering ones bar a fifth of it, where the plant itself stands, invite around
  that, and keep away from one radius on. They are chosen so that 100 plants have the Hopkins indices of Figure 5.4.
  Plants that only bar come no lower than 0.45; a square lattice has 0.38.
- Lane's loops apply a kernel within r. Here each kernel has a reach of its own.
- A kernel that invites draws plants from everywhere, and numbers no longer follow the map. `balanced` is ours and
  mends that. A balanced kernel that bars all that is left within its reach takes its probability away even so.
- The field does not depend on the size of the plant that arrives, only on those that stand. So inhibition keeps stems
  apart, not crowns: two equal plants may overlap by up to half.
- Sizes are log-normal, cut off at the species' largest radius. A species' sizes, and the random numbers that place
  its plants, depend on the recipe's seed and on its name alone: on one grid, another species that it does not see
  leaves it where it was.
- Cells are an eighth of the least median radius, kernel reach in metres, or spacing; at most 2^25 in all fields.
  Where that is too coarse a note says so. A kernel counts at a cell's middle: a hard core may be violated by part of
  a diagonal.
- Kernels that would change more than 2e10 cells in all, about a minute's work, are refused before the first plant.
- Plants that find no place are left out, and a note says how many and why.
- {hopkins: H}: all kernels are one, of the family in `placement/clustering.py`, found by bisection with the same
  random numbers, on the plants themselves or, of more than 2,000, on every k-th of them on a smaller site. H is
  that of all plants together, in the window of the site, as `forestgen simulate` reports it. Plants keep to the map. A
  target that cannot be reached ends as near as possible. statistics.json has the kernel that was found and what H came
  to; if that differs from the target by more than 0.05, or above 1 by more than 5 percent, a note says so too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.ground.living_conditions import Conditions
from forestgen.community.placement import clustering
from forestgen.community.placement import kernels as placement_kernels
from forestgen.community.placement import model as placement
from forestgen.community.placement.densities import (
    COUNTING_CELLS,
    MOST_ALONG,
    PlacementParameters,
    cells_for,
    grid_shape,
    plant_counts,
    sizes_of,
    species_density,
)
from forestgen.community.placement.field import DensityField, place
from forestgen.community.population import Ecologies, Floats, Population, Site
from forestgen.community.static_model import State, first_state
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Whole
from forestgen.recipe.sources import Keys

_NO_CONDITIONS = Conditions.model_validate({})
_CELLS_PER_LENGTH = 8  # a radius, a reach in metres, or the plants' spacing
_FEWEST_CELLS = 64  # along the site's longer side
_MOST_PIXELS = 2048  # of a map, along its longer side, that its own detail asks for
_IDLE, _MANY = 0.2, 100  # reach over spacing below which kernels hardly act, of so many plants
_BLURRED = 2  # cells per length: with fewer, a note says so
_BYTES_PER_CELL = 24  # of a field and what it sums up
_MOST_CHANGES = 2e10  # of cells by all plants: 50 s of one core
_BARRED = "the map, the conditions and keep_out bar the whole site"
_NO_PLACE = "no place is left where the kernels of those that stand, the map and the conditions allow one"
_BYTES_PER_CELL_MADE = 40  # of the one field that is being read from map and conditions


class DeformationKernelParameters(PlacementParameters):
    """What a recipe says about the model besides its species."""

    memory_hint: ClassVar[str] = f"{PlacementParameters.memory_hint}, or fewer community.cells"

    kernels: placement_kernels.Kernels = Field(
        placement_kernels.KernelSection(**placement_kernels.NAMED["inhibition"]),
        description="One kernel for all plants; or kernels by the species that acts, or by that and the species that "
        "is affected, where a pair left out is neutral; or {hopkins: H}, how clustered the plants are to be",
    )
    cells: Whole | None = Field(
        None,
        ge=16,
        le=MOST_ALONG,
        description="cells of the fields along the site's longer side; null: an eighth of a radius, a kernel's reach "
        "in metres, or the plants' spacing, whichever is least",
    )

    @property
    def hopkins(self) -> float | None:
        """The Hopkins index that the plants are to have; None: the recipe gives the kernels."""
        return self.kernels.hopkins if isinstance(self.kernels, placement_kernels.HopkinsTarget) else None

    def matrix(self, names: Sequence[str]) -> Sequence[Sequence[placement_kernels.KernelTable]]:
        """Kernels [i][j] that the recipe gives: the effect of a plant of species j on the field of species i."""
        assert not isinstance(self.kernels, placement_kernels.HopkinsTarget)
        return placement_kernels.kernel_matrix(self.kernels, names)

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("kernels", *keys), name) for keys, name in placement_kernels.species_named(self.kernels))


@dataclass(frozen=True)
class _Layout:
    """Which fields there are, and of what grid."""

    species: tuple[int, ...]  # (F,) index of the species whose density each field has
    field_of: NDArray[np.intp]  # (S,) index of each species' field; -1: it has no plants
    cells: int  # along the site's longer side
    length_m: float  # the finest detail that the grid should show: a median radius, a kernel's reach, or the spacing

    def densities(
        self, parameters: PlacementParameters, site: Site, species: Ecologies, shape: tuple[int, int]
    ) -> list[Floats]:
        """(rows, cols) of each field."""
        return [species_density(parameters, site, species[i].name, shape) for i in self.species]


def _layout(parameters: DeformationKernelParameters, site: Site, species: Ecologies) -> _Layout:
    counts = plant_counts(parameters, site, species)
    present = np.flatnonzero(counts).tolist()
    stands = [parameters.plants[species[i].name] for i in present]
    level = all(stand.conditions == _NO_CONDITIONS for stand in stands)
    bare = level and all(stand.map is None for stand in stands)
    shared = bare and isinstance(parameters.kernels, placement_kernels.KernelSection | placement_kernels.HopkinsTarget)
    field_of = np.full(len(species), -1, dtype=np.intp)
    field_of[present] = 0 if shared else np.arange(len(present))
    chosen = tuple(present[:1] if shared else present)
    length_m = _spacing_m(site, counts)
    for reach_m, median_m, in_radii in _acting(parameters, species, counts):
        length_m = min(length_m, reach_m, median_m if in_radii else math.inf)
    if parameters.cells is not None:
        return _Layout(chosen, field_of, parameters.cells, length_m)
    maps = [one for one in (parameters.keep_out, *(stand.map for stand in stands)) if one is not None]
    pixels = min(_MOST_PIXELS, max((max(one.shape) for one in maps), default=0))
    at_least = max(_FEWEST_CELLS, pixels, 0 if level else COUNTING_CELLS)
    per_length = _CELLS_PER_LENGTH if parameters.hopkins is None else clustering.CELLS_PER_SPACING
    cells = cells_for(site, length_m, per_length=per_length, at_least=at_least, fields=len(chosen))
    return _Layout(chosen, field_of, cells, length_m)


def _spacing_m(site: Site, counts: NDArray[np.int64]) -> float:
    """Root of the area that a plant has, metres."""
    return math.sqrt(site.area_m2 / max(1, int(counts.sum())))


def _acting(
    parameters: DeformationKernelParameters, species: Ecologies, counts: NDArray[np.int64]
) -> Iterator[tuple[float, float, bool]]:
    """Of each given kernel that acts: its reach about a plant of median radius; that radius; whether it is in radii."""
    if parameters.hopkins is not None:
        return
    kernels = parameters.matrix([one.name for one in species])
    for j, one in enumerate(species):
        if counts[j]:
            median_m = sizes_of(parameters.plants[one.name].radius_m, one).median
            acting = [row[j] for row in kernels if not row[j].is_neutral]
            yield from ((float(table.reach_m(median_m)), median_m, table.in_radii) for table in acting)


class DeformationKernel(placement.PlacementModel[DeformationKernelParameters]):
    Parameters = DeformationKernelParameters
    state_keys = ("clustering",)

    def init(self, parameters: DeformationKernelParameters, site: Site, species: Ecologies, seed: int) -> State:
        """The plants at their places."""
        rng = child_rng(seed, "community", 0)
        wanted = placement.wanted_plants(parameters, site, species, rng)
        uniform = placement.uniform_samples(wanted, species, rng)
        layout = _layout(parameters, site, species)
        densities = layout.densities(parameters, site, species, grid_shape(site, layout.cells))
        found = _found(parameters, site, species, layout, densities, wanted, uniform, seed)
        if parameters.hopkins is None:
            kernels = parameters.matrix([species[i].name for i in layout.species])
        else:
            kernels = [[found.kernel if found else placement_kernels.NEUTRAL] * len(densities)] * len(densities)
        barred = {i for i, one in enumerate(layout.field_of) if one >= 0 and not densities[one].any()}
        fields = [DensityField(one, site.size_m, periodic=parameters.periodic) for one in densities]
        del densities
        position_m = place(fields, layout.field_of[wanted.sp], wanted.r_m, kernels, uniform).position_m
        why = {one.name: _BARRED if i in barred else _NO_PLACE for i, one in enumerate(species)}
        placed = placement.placement_of(parameters, site, species, wanted, position_m, why)
        notes, state = [*placed.notes, *_notes(site, layout), *_idle(parameters, site, species)], {}
        if parameters.hopkins is not None:
            points_m = placed.position_m
            state = {"clustering": clustering.describe(parameters.hopkins, found, points_m, site, seed, layout.cells)}
            notes += clustering.notes_on(state["clustering"])
        return first_state(parameters, site, species, seed, replace(placed, notes=tuple(notes), found=state))

    def estimate_bytes(self, parameters: DeformationKernelParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all plants and the fields at once."""
        plants = super().estimate_bytes(parameters, site, species)
        layout = _layout(parameters, site, species)
        cells = math.prod(grid_shape(site, layout.cells))
        _check_work(parameters, site, species, [species[i].name for i in layout.species], cells)
        return plants + cells * (len(layout.species) * _BYTES_PER_CELL + _BYTES_PER_CELL_MADE)

    def densities(
        self, parameters: DeformationKernelParameters, site: Site, species: Ecologies, placed: Population
    ) -> placement.Densities:
        """What the recipe asks for, and the fields that are left when the plants `placed` have deformed them."""
        if parameters.hopkins is not None:
            return placement.asked_densities(parameters, site, species)
        cells = min(max(_layout(parameters, site, species).cells, COUNTING_CELLS), 2048)
        asked = placement.asked_densities(parameters, site, species, grid_shape(site, cells))
        kernels = parameters.matrix([one.name for one in species])
        return placement.deformed(asked, site, parameters.periodic, species, placed, kernels)


def _check_work(
    parameters: DeformationKernelParameters, site: Site, species: Ecologies, fields: Sequence[str], cells: int
) -> None:
    """Refuse kernels that would change more cells of the fields, by species, than a minute allows."""
    acting = {}
    for one, count in zip(species, plant_counts(parameters, site, species).tolist(), strict=True):
        if count:
            sizes = sizes_of(parameters.plants[one.name].radius_m, one)
            acting[one.name] = (count, min(sizes.median * math.exp(sizes.sigma**2), one.max_radius_m))  # mean square
    words = (
        "changes of cells by all plants, about a minute's work",
        f"{sum(count for count, _ in acting.values()):,} plants on a grid of {cells:,} cells",
        "fewer plants, or a smaller community.cells",
    )
    placement_kernels.refuse_long_work(
        parameters.kernels, site, acting, dict.fromkeys(fields, cells), _MOST_CHANGES, words
    )


def _found(
    parameters: DeformationKernelParameters,
    site: Site,
    species: Ecologies,
    layout: _Layout,
    densities: Sequence[Floats],
    wanted: placement.PlantingTargets,
    uniform: Floats,
    seed: int,
) -> clustering.Found | None:
    """The kernel that gives the recipe's Hopkins index; None: it names none, or there are too few plants."""
    field = layout.field_of[wanted.sp]
    n = len(field)
    if parameters.hopkins is None or n < clustering.FEWEST or not all(one.any() for one in densities):
        return None
    counts = np.bincount(field, minlength=len(densities))
    spacing_m = clustering.spacing(densities, counts, site.area_m2)
    few = slice(None, None, math.ceil(n / clustering.MOST_TRIAL_PLANTS))
    share = len(field[few]) / n
    size_m = (site.size_m[0] * math.sqrt(share), site.size_m[1] * math.sqrt(share))
    if share < 1:
        shape = grid_shape(site, max(_FEWEST_CELLS, round(layout.cells * math.sqrt(share))))
        densities = layout.densities(parameters, site, species, shape)
    return clustering.kernel_for(
        parameters.hopkins,
        clustering.TrialPlacement(densities, size_m, parameters.periodic, field[few], uniform[few], spacing_m, seed),
    )


def _notes(site: Site, layout: _Layout) -> list[str]:
    """A note if cells are too large for the finest detail."""
    cell_m = max(site.size_m) / layout.cells
    if cell_m * _BLURRED <= layout.length_m:
        return []
    return [
        f"kernels are blurred: cells are {cell_m:.3g} m wide, against a radius, reach or spacing of "
        f"{layout.length_m:.3g} m; raise community.cells"
    ]


def _idle(parameters: DeformationKernelParameters, site: Site, species: Ecologies) -> list[str]:
    """A note if many plants stand so far from each other that their kernels hardly ever meet another plant."""
    counts = plant_counts(parameters, site, species)
    spacing_m = _spacing_m(site, counts)
    reach_m = max((one for one, _, _ in _acting(parameters, species, counts)), default=0.0)
    if counts.sum() < _MANY or not 0.0 < reach_m < _IDLE * spacing_m:
        return []
    return [
        f"kernels hardly act: they reach {reach_m:.2g} m, and plants stand {spacing_m:.2g} m apart; "
        "give larger radii, a kernel with distance: metres, or a target ({hopkins: ...})"
    ]


MODEL = DeformationKernel()
