"""Numbers of identity: what is published of their mixing."""

from __future__ import annotations

import numpy as np

from forestgen.core.compiled import compiled, inlined_exactly
from forestgen.core.randomness import SPLIT_MIX_STEP, mixed

# Steele, Lea and Flood 2014; the first numbers of the stream of 1234567 (Vigna's splitmix64.c).
FIRST = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431, 16408922859458223821]
_mixed = inlined_exactly(mixed)


@compiled
def _stream(state, n):  # type: ignore[no-untyped-def]
    out = np.zeros(n, dtype=np.uint64)
    for i in range(n):
        state += SPLIT_MIX_STEP
        out[i] = _mixed(state)
    return out


def test_mixed_is_the_finaliser_of_splitmix64_in_arrays_and_in_kernels() -> None:
    states = np.uint64(1234567) + SPLIT_MIX_STEP * np.arange(1, 6, dtype=np.uint64)
    assert mixed(states).tolist() == FIRST
    assert _stream(np.uint64(1234567), 5).tolist() == FIRST
