"""What to grow of dead trees: the whole tree that each was, and what is left of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.dead_wood import DeadForm, DeadTree, dbh_of_stump_m
from forestgen.plants.bark.texture import with_bark_tiles
from forestgen.plants.build import tree_size
from forestgen.plants.dead_exemplar import bare_parameters, with_dead_wood
from forestgen.plants.growing import ExemplarRequest
from forestgen.recipe.tree_sizes import NUMBERS, TreeSizes

_SLENDEREST = 100.0  # height over diameter, of trees too low to be measured

Floats = NDArray[np.float64]
_MEDIAN = np.zeros((1, NUMBERS))


def of_dead(request: ExemplarRequest, dead: DeadTree | None) -> ExemplarRequest:
    """The request for a tree, with `request.tree` the sizes of what is left, as one for the tree that it was.

    `dead`: None: it lives, and the request stays.
    """
    law, left = request.species.tree, request.tree
    if dead is None or law is None or left is None:
        return request
    dbh_m = left.dbh_m
    if dead.form == DeadForm.STUMP:
        whole_m = float(law.height_of(np.array([dbh_m]), _MEDIAN)[0])
    else:
        whole_m = left.height_m / dead.left
    if np.isnan(dbh_m):
        dbh_m = whole_m / _SLENDEREST
    sizes = law.sizes(np.array([whole_m]), _MEDIAN, 0.0, np.array([dbh_m]))
    tree = replace(tree_size(request.species, whole_m, sizes), dbh_m=dbh_m)
    species = with_dead_wood(request.species)
    parameters = with_bark_tiles(bare_parameters(request.parameters, dead), species.materials)
    return replace(request, species=species, parameters=parameters, tree=tree, dead=dead)


def dead_library_tree(law: TreeSizes, dead: DeadTree, height_m: float) -> Floats:
    """(5,) sizes of what is left of a library's tree of a height, in the order of `TreeSize`; it has no leaves."""
    if dead.form == DeadForm.STUMP:
        return np.array([height_m, height_m, dbh_of_stump_m(height_m), 0.0, 0.0])
    sizes = law.sizes(np.array([height_m / dead.left]), _MEDIAN)
    base_m = min(float(sizes.crown_base_m[0]), height_m)
    return np.array([height_m, float(sizes.crown_width_m[0]), float(sizes.dbh_m[0]), base_m, 0.0])
