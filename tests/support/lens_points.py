"""The points of the lens that identity samples go through, in NumPy: an oracle of the tracer's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.render.identity.tracer import HASH_ROUNDS, LENS_STEPS

Floats = NDArray[np.float64]


def lens_points(column: NDArray[np.integer], row: NDArray[np.integer], number: NDArray[np.integer]) -> Floats:
    """(*S, 2) points of the unit disc through which the samples of pixels go; uniform over it.

    A pixel's samples are points (a, b) of the R2 sequence on the torus, shifted by two random numbers of the pixel,
    in whole steps of 2^-32; then r = sqrt(a), phi = 2 pi b. Neighbouring pixels differ in their shift. The tracer has
    the same a and b, and the rest in single precision.

    `column`, `row`, `number`: (*S,) pixel and number of the sample in it.
    """
    count = np.asarray(number, dtype=np.uint32)
    with np.errstate(over="ignore"):
        a, b = (
            ((shift + count * np.uint32(step)) >> np.uint32(8)) * 2.0**-24
            for shift, step in zip(pixel_hash(column, row), LENS_STEPS, strict=True)
        )
    radius, angle = np.sqrt(a), 2 * np.pi * b
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def pixel_hash(column: NDArray[np.integer], row: NDArray[np.integer]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Two random 32-bit numbers of a pixel: rounds of the cipher TEA.

    References
    ----------
    Zafar, Olano and Curtis 2010, "GPU random numbers via the tiny encryption algorithm", HPG.
    """
    keys = [np.uint32(key) for key in (0xA341316C, 0xC8013EA4, 0xAD90777D, 0x7E95761E)]
    first, second = (np.array(value, dtype=np.uint32) for value in np.broadcast_arrays(column, row))
    total = np.zeros((), dtype=np.uint32)
    with np.errstate(over="ignore"):
        for _ in range(HASH_ROUNDS):
            total = total + np.uint32(0x9E3779B9)
            first = first + (
                ((second << np.uint32(4)) + keys[0]) ^ (second + total) ^ ((second >> np.uint32(5)) + keys[1])
            )
            second = second + (
                ((first << np.uint32(4)) + keys[2]) ^ (first + total) ^ ((first >> np.uint32(5)) + keys[3])
            )
    return first, second
