"""Dead trees as foresters class them: what is left of a tree, and how far it has decayed.

Decay classes are the five of the USDA Forest Service. Standing: 1 all limbs, pointed top, all bark; 2 few limbs, no
fine branches; 3 limb stubs, broken top; 4 few or no stubs; 5 no limbs, under 20% of the bark (Domke et al. 2011, Carbon
Balance and Management 6:14, table 1). Down: 1 intact; 2 fine twigs gone, bark loose; 3 large limbs, bark in patches; 4
stubs, no bark, settled on the ground; 5 no limbs, sunk in (after Maser et al. 1979, Agriculture Handbook 553, and
Woodall and Monleon 2008, USDA Forest Service GTR NRS-22).

Stems taper as those of living trees (`forestgen.core.stem_form`). What is left of one ends at a share of the whole
tree's height by form and class, so that the height of what is left gives that of the whole tree.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from forestgen.core.stem_form import volume_above_m3

Floats = NDArray[np.float64]
Codes = NDArray[np.integer]

CLASSES = 5
UNKNOWN_CLASS = 2  # of dead trees without a class
SNAPPED_AT = 0.2  # share of its height at which a stem snaps
_STEP = 8  # between the codes of forms


class DeadForm(IntEnum):
    """What is left of a tree. The numbers are written to files: never renumber."""

    NONE = 0  # it lives
    STANDING = 1
    UPROOTED = 2  # lies whole beside its root plate
    SNAPPED = 3  # a high stump, and the stem above it on the ground
    STUMP = 4  # of a felled tree


LYING = (DeadForm.UPROOTED, DeadForm.SNAPPED)
_LEFT = {  # share of the height that is left, by decay class; lying stems: of the length
    DeadForm.STANDING: (1.0, 1.0, 0.85, 0.6, 0.3),
    DeadForm.UPROOTED: (1.0, 1.0, 0.92, 0.8, 0.65),
    DeadForm.SNAPPED: (1.0, 1.0, 0.92, 0.8, 0.65),
}


@dataclass(frozen=True)
class DeadTree:
    """The form and the decay class of a dead tree."""

    form: DeadForm
    decay: int  # 1 to 5

    @classmethod
    def of(cls, code: int) -> DeadTree | None:
        """The dead tree of a code, see `dead_codes`; None: it lives."""
        return cls(DeadForm(code // _STEP), code % _STEP) if code else None

    @property
    def lies(self) -> bool:
        return self.form in LYING

    @property
    def left(self) -> float:
        """Share of the whole tree's height at which the stem ends; 1 of a stump."""
        return _LEFT[self.form][self.decay - 1] if self.form in _LEFT else 1.0


def dead_codes(form: Codes, decay: Codes) -> NDArray[np.int64]:
    """(N,) one number of form and class; 0: alive."""
    return np.where(np.asarray(form) == 0, 0, _STEP * np.asarray(form, np.int64) + np.asarray(decay, np.int64))


def are_lying(form: Codes) -> NDArray[np.bool_]:
    """(N,) whether trees of these forms lie on the ground."""
    return np.isin(form, LYING)


def left_of(form: Codes, decay: Codes) -> Floats:
    """(N,) share of the whole tree's height at which the stem ends, see `DeadTree.left`; 1 of the living."""
    shares = np.ones((len(DeadForm), CLASSES + 1))
    for one, values in _LEFT.items():
        shares[one, 1:] = values
    return np.asarray(shares[form, decay])


def stump_height_m(dbh_m: Floats) -> Floats:
    """(N,) height at which trees were felled: a third of the diameter, 0.1 to 0.4 m."""
    return np.clip(dbh_m / 3.0, 0.1, 0.4)


def dbh_of_stump_m(height_m: float) -> float:
    """Diameter of a felled tree, whose stump has a height."""
    return 3.0 * height_m


def lying_volume_m3(form: Codes, decay: Codes, height_m: Floats, dbh_m: Floats) -> Floats:
    """(N,) volume of the stem that lies on the ground, over bark; 0 of standing trees and stumps.

    `height_m`: of what is left; of a lying stem its length, with that of its high stump.
    """
    begins = np.where(np.asarray(form) == DeadForm.SNAPPED, SNAPPED_AT, 0.0)
    return np.where(are_lying(form), _volume_m3(begins, left_of(form, decay), height_m, dbh_m), 0.0)


def standing_volume_m3(form: Codes, decay: Codes, height_m: Floats, dbh_m: Floats) -> Floats:
    """(N,) volume of the stem from the ground to where it ends, over bark, of standing trees."""
    return _volume_m3(np.zeros(len(height_m)), left_of(form, decay), height_m, dbh_m)


def _volume_m3(begins: Floats, left: Floats, height_m: Floats, dbh_m: Floats) -> Floats:
    """(N,) volume of a stem between two shares of the whole tree's height; `height_m`: at the second."""
    whole = height_m / left
    return volume_above_m3(begins * whole, whole, dbh_m) - volume_above_m3(left * whole, whole, dbh_m)
