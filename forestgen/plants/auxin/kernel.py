"""Compiled loops of the auxin model; see model.py for what they mean."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled

Floats = NDArray[np.float64]

# Numbers of `number`, in their order.
SUPPLY, TRANSPORT, DECAY, INHIBITION, SENSITIVITY, DIAMETER, SEGMENT, STEP, LONGEST, ON_FLANK, MOST_WORK = range(11)
# Sums of `ledger`, in their order.
SUPPLIED, OUT, DECAYED = range(3)
REACH = 6.0  # widths of the growth zone beyond which nothing grows


@compiled
def bend(side: Floats, cosine: Floats, sine: Floats, diameter: float) -> Any:
    """Angle by which a segment turns away from azimuth 0 and away from azimuth 90 degrees, radians.

    The plane that fits the ends of the sides best; of two sides, Eq. 1 of Streit et al.
    """
    x = y = norm = 0.0
    for k in range(len(side)):
        x += side[k] * cosine[k]
        y += side[k] * sine[k]
        norm += cosine[k] * cosine[k]
    scale = 2.0 / (diameter * norm)
    return x * scale, y * scale


@compiled
def turn(frame: Floats, x: float, y: float) -> None:
    """Turn the frame (rows: azimuth 0, azimuth 90, tangent) away from azimuth 0 by x and from azimuth 90 by y."""
    angle = math.sqrt(x * x + y * y)
    if angle < 1e-15:
        return
    cosine, sine = math.cos(angle), math.sin(angle)
    x /= angle
    y /= angle
    for c in range(3):
        out = x * frame[0, c] + y * frame[1, c]
        forth = frame[2, c]
        new = cosine * out + sine * forth - out
        frame[0, c] += x * new
        frame[1, c] += y * new
        frame[2, c] = cosine * forth - sine * out


@compiled
def assemble(side: Floats, cosine: Floats, sine: Floats, diameter: float, frame: Floats, point: Floats) -> None:
    """Centres of the segments' faces, base to tip; each segment is an arc. `frame` becomes the tip's."""
    for i in range(len(side)):
        x, y = bend(side[i], cosine, sine, diameter)
        half = 0.5 * math.sqrt(x * x + y * y)
        chord = np.mean(side[i]) * (math.sin(half) / half if half > 1e-8 else 1.0)
        turn(frame, 0.5 * x, 0.5 * y)
        for c in range(3):
            point[i + 1, c] = point[i, c] + chord * frame[2, c]
        turn(frame, 0.5 * x, 0.5 * y)


@compiled
def transport(side: Floats, auxin: Floats, number: Floats, share: Floats, ledger: Floats) -> None:
    """One step of polar transport from the tip back, upwind and implicit: stable and exactly conserving."""
    step, speed, decay = number[STEP], number[TRANSPORT], number[DECAY]
    ledger[SUPPLIED] += step * number[SUPPLY]
    for k in range(side.shape[1]):
        flow = number[SUPPLY] * share[k]
        for i in range(len(side) - 1, -1, -1):
            rate = speed / side[i, k]
            auxin[i, k] = (auxin[i, k] + step * flow) / (1.0 + step * (rate + decay))
            flow = rate * auxin[i, k]
            ledger[DECAYED] += step * decay * auxin[i, k]
        ledger[OUT] += step * flow


@compiled
def elongate(
    side: Floats, auxin: Floats, number: Floats, peak: Floats, centre: Floats, width: Floats, first: int
) -> Any:
    """One step of growth of all sides from segment `first` on, the tip's segment excepted.

    Returns
    -------
    The first segment that may still grow; those before it lie behind the growth zone for good.
    """
    n, sectors = side.shape
    step, inhibition, on_flank = number[STEP], number[INHIBITION], number[ON_FLANK] > 0.0
    growing = n - 1
    centre_line = np.empty(n - first)
    for i in range(first, n):
        centre_line[i - first] = np.mean(side[i])
    for k in range(sectors):
        away = side[n - 1, k] if on_flank else centre_line[n - 1 - first]
        root2 = math.sqrt(2.0) * width[k]
        whole = peak[k] * width[k] * math.sqrt(0.5 * math.pi)
        before = math.erf((away - centre[k]) / root2)
        for i in range(n - 2, first - 1, -1):
            if away > centre[k] + REACH * width[k]:
                break
            growing = min(growing, i)
            length = side[i, k]
            passed = length if on_flank else centre_line[i - first]
            away += passed
            after = math.erf((away - centre[k]) / root2)
            held = max(0.0, 1.0 - inhibition * sectors * auxin[i, k] / length)
            side[i, k] = length * math.exp(step * held * whole * (after - before) / passed)
            before = after
    return growing


@compiled
def split(side: Floats, auxin: Floats, n: int, first: int, segment: float) -> Any:
    """Halve every segment from `first` on, but the tip's, that is longer than `segment`; the new number of segments."""
    i = first
    while i < n - 1:
        if np.mean(side[i]) > segment:
            if n == len(side):
                return -1
            for j in range(n, i + 1, -1):
                side[j] = side[j - 1]
                auxin[j] = auxin[j - 1]
            side[i] *= 0.5
            auxin[i] *= 0.5
            side[i + 1] = side[i]
            auxin[i + 1] = auxin[i]
            n += 1
            i += 1
        i += 1
    return n


@compiled
def grow(
    side: Floats,
    auxin: Floats,
    n: int,
    frame: Floats,
    target: Floats,
    cosine: Floats,
    sine: Floats,
    number: Floats,
    peak: Floats,
    centre: Floats,
    width: Floats,
    tip: Floats,
    ledger: Floats,
) -> Any:
    """Time steps until the root is as long as it should be, or the steps are used up.

    Returns
    -------
    steps done, number of segments (-1: there is no room for more, -2: it takes too long).
    """
    sectors, work = side.shape[1], 0.0
    share, first, frozen_mm, end = np.empty(sectors), 0, 0.0, np.empty((3, 3))
    for step in range(len(tip) - 1):
        length = frozen_mm
        end[:] = frame
        for i in range(first, n):
            x, y = bend(side[i], cosine, sine, number[DIAMETER])
            turn(end, x, y)
            length += np.mean(side[i])
        tip[step] = end[2]
        if length >= number[LONGEST]:
            return step, n
        work += n * sectors
        if work > number[MOST_WORK]:
            return step, -2
        for k in range(sectors):
            towards = 0.0
            for c in range(3):
                towards += (cosine[k] * end[0, c] + sine[k] * end[1, c]) * target[c]
            share[k] = (1.0 + number[SENSITIVITY] * towards) / sectors
        transport(side[:n], auxin[:n], number, share, ledger)
        growing = elongate(side[:n], auxin[:n], number, peak, centre, width, first)
        for i in range(first, growing):
            x, y = bend(side[i], cosine, sine, number[DIAMETER])
            turn(frame, x, y)
            frozen_mm += np.mean(side[i])
        first = growing
        n = split(side, auxin, n, first, number[SEGMENT])
        if n < 0:
            return step, n
    end[:] = frame
    for i in range(first, n):
        x, y = bend(side[i], cosine, sine, number[DIAMETER])
        turn(end, x, y)
    tip[len(tip) - 1] = end[2]
    return len(tip) - 1, n
