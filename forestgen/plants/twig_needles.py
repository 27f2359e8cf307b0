"""Needles of true size along the twigs between shoots, near a camera; which twigs: `needle_twigs`.

They are as dense there as on shoots, but no shoot gives up more than half of its own. Pieces of about one length,
thickness and density share a mesh, which is scaled to the length.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Floats, Ints
from forestgen.geometry.patches import attitude
from forestgen.plants.organs.needles import NeedleTwig
from forestgen.plants.organs.sprays import NEEDLES_ALONG, Needles, Spray, twig_spray
from forestgen.plants.skeleton import Twigs

_MOST_SHARE = 0.5
_PARTS = 8  # steps of the share
_STEP = 1.25  # between lengths, and between densities
_RADIUS_M = 0.001  # between thicknesses


@dataclass(frozen=True)
class TwigNeedles:
    """Needles that stand on twigs below shoots."""

    share: Floats  # (M,) of each shoot's needles
    per_m: Floats  # (S,) true ones on a metre of each piece

    @classmethod
    def of(cls, twigs: Twigs, number: Floats, needle_m: float) -> TwigNeedles:
        """`number`: (M,) true needles of each shoot and the twig below it together; 0: not drawn."""
        length_m = np.bincount(twigs.organ, _lengths(twigs), minlength=len(number))
        wanted = np.minimum(NEEDLES_ALONG / needle_m * length_m / np.maximum(number, 1e-9), _MOST_SHARE)
        share = np.where(number > 0.0, np.rint(_PARTS * wanted) / _PARTS, 0.0)
        per_m = share * number / np.maximum(length_m, 1e-9)
        return cls(share, per_m[twigs.organ])


def sprays_on_twigs(
    form: NeedleTwig, needle_m: float, twigs: Twigs, needles: TwigNeedles, alike: Ints
) -> Iterator[tuple[Spray, NDArray[np.float32], Ints]]:
    """Needles on pieces of twigs, each mesh with its frames and the shoots that the needles are taken from.

    `alike`: (M, 4) of each shoot: needles that one stands for, detail, variant, and what else tells meshes apart.
    """
    drawn = np.flatnonzero(needles.per_m > 0.0)
    length_m, per_m = _lengths(twigs)[drawn], needles.per_m[drawn]
    steps = [np.rint(np.log(one) / np.log(_STEP)).astype(np.int64) for one in (length_m, per_m)]
    steps.append(np.rint(twigs.radius_m[drawn] / _RADIUS_M).astype(np.int64))
    organ = twigs.organ[drawn].astype(np.int64)
    found, which = np.unique(np.column_stack([*steps, alike[organ]]), axis=0, return_inverse=True)
    for number, key in enumerate(found.tolist()):
        group = np.flatnonzero(which.reshape(-1) == number)
        long_m, dense = _STEP ** key[0], _STEP ** key[1]
        true = round(long_m * dense)
        if 2 * true < key[3]:  # less than half of what is drawn as one
            continue
        spray = twig_spray(form, Needles(needle_m, true, key[3], key[4]), long_m, _RADIUS_M * key[2], key[5])
        low, high = twigs.ends_m[drawn[group]].astype(np.float64).transpose(1, 0, 2)
        linear = attitude(high - low, np.tile([0.0, 0.0, 1.0], (len(group), 1)))
        linear *= (length_m[group] / long_m)[:, None, None]
        yield spray, np.concatenate([linear, low[:, :, None]], axis=2).astype(np.float32), organ[group]


def _lengths(twigs: Twigs) -> Floats:
    low, high = twigs.ends_m.astype(np.float64).transpose(1, 0, 2)
    return np.asarray(np.linalg.norm(high - low, axis=1))
