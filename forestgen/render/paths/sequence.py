"""Points that fill the unit square evenly: for each pixel, each choice of a path its own.

Sobol's first two dimensions, scrambled by hashes as Owen scrambles (Burley 2020, "Practical hash-based Owen
scrambling"). Any first N points are spread evenly, best where N is a power of two, and every choice shuffles them anew.
A point is a function of seed, pixel, number and choice: it does not depend on other points, nor on where work is cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from forestgen.render.variant import drjit, mitsuba

_GOLDEN = 0x9E3779B9  # 2^32 over the golden ratio: steps that never meet
_SQUARES = ((16, 0xFFFFFFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555))


@dataclass(frozen=True)
class Sequence:
    """Points of P paths."""

    key: Any  # UInt32, of the pixel
    number: Any  # UInt32, of the path in its pixel

    def pair(self, choice: Any) -> tuple[Any, Any]:
        """(P,) each in [0, 1): the point of one choice, a UInt32."""
        mi, dr = mitsuba(), drjit()
        seeds = [hashed(self.key + mi.UInt32(choice) * _GOLDEN + (k * 0x85EBCA6B & 0xFFFFFFFF)) for k in range(3)]
        first = _scrambled(dr.brev(self.number), seeds[0])  # the shuffled number's bits, reversed
        second = second_dimension(first)
        one, other = (
            to_unit(dr.brev(_scrambled(dr.brev(bits), seed)))
            for bits, seed in zip((first, second), seeds[1:], strict=True)
        )
        return one, other


def sequence_of(seed: Any, pixel: Any, number: Any) -> Sequence:
    """Points of paths by their pixels and their numbers there, all UInt32."""
    mi = mitsuba()
    return Sequence(mi.sample_tea_32(seed, pixel, 4)[0], number)


def hashed(value: Any) -> Any:
    """UInt32, well mixed (Wang and Mueller's integer finaliser)."""
    value = (value ^ (value >> 16)) * 0x7FEB352D
    value = (value ^ (value >> 15)) * 0x846CA68B
    return value ^ (value >> 16)


def second_dimension(first: Any) -> Any:
    """Bits of Sobol's second number of those of the first: Pascal's triangle modulo 2."""
    mi = mitsuba()
    for shift, mask in _SQUARES:
        first = first ^ ((first & mi.UInt32(mask)) << shift)
    return first


def _scrambled(reversed_bits: Any, seed: Any) -> Any:
    """Each bit flipped by a hash of those after it (Laine and Karras; constants of Burley's paper)."""
    value = reversed_bits + seed
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        value = value ^ (value * factor)
    return value


def to_unit(bits: Any) -> Any:
    """Float in [0, 1) of 32 bits."""
    mi = mitsuba()
    return mi.Float(bits >> 8) * 2.0**-24
