"""Dead trees of a list: their decay classes, and the heights of what is left."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Ecologies, Floats, Indices
from forestgen.community.stand.build import heights_of
from forestgen.community.stand.tree_checks import are_trees
from forestgen.community.stand.tree_list import TreeList
from forestgen.core.dead_wood import UNKNOWN_CLASS, DeadForm, left_of
from forestgen.recipe.tree_sizes import NUMBERS

_BROKEN, _LOW = 0.72, 0.45  # height over that by the diameter: below, a standing tree is of class 4, of class 5


def decayed(
    trees: TreeList, rows: Indices, sp: Indices, species: Ecologies, height_m: Floats
) -> tuple[Floats, NDArray[np.uint8]]:
    """(M,) heights of what is left of trees, and (M,) decay classes, 0 of the living.

    `rows`: (M,) of the list. `height_m`: (M,) of the list, and of whole trees where it says none.
    """
    form, listed = trees.form[rows], trees.number("height_m")[rows]
    decay = np.where(form > 0, np.nan_to_num(np.round(trees.number("decay_class")[rows]), nan=0.0), 0.0)
    dbh_m = trees.number("dbh_m")[rows]
    unknown = (form > 0) & (decay == 0)
    decay[unknown] = UNKNOWN_CLASS
    both = np.flatnonzero(unknown & (form == DeadForm.STANDING) & are_trees(species, sp) & ~np.isnan(listed + dbh_m))
    if len(both):
        usual = heights_of(species, sp[both], dbh_m[both], np.zeros((len(both), NUMBERS)), np.zeros(len(both)))
        share = listed[both] / usual
        decay[both] = np.where(share < _LOW, 5, np.where(share < _BROKEN, 4, UNKNOWN_CLASS))
    classes = decay.astype(np.uint8)
    return np.where(np.isnan(listed), height_m * left_of(form, classes), height_m), classes
