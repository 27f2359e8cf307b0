"""Numbers that are drawn anew for each image.

=============  ==========================================================  ===========================================
written        as                                                          means
=============  ==========================================================  ===========================================
uniform        ``{uniform: [a, b]}``                                       any number from a to b, equally likely
normal         ``{normal: [mean, sd]}``,                                   Gaussian; with low or high, the Gaussian
               ``{normal: {mean:, sd:, low:, high:}}``                     given that it lies between them
lognormal      ``{lognormal: [median, sigma]}``,                           exp of a Gaussian of mean log(median) and
               ``{lognormal: {median:, sigma:, low:, high:}}``             standard deviation sigma
integers       ``{integers: [a, b]}``                                      any whole number from a to b, both included
choice         ``{choice: [x, y, ...]}``                                   one of the numbers or texts, equally likely
sequence       ``{sequence: [x, y, ...]}``                                 of image 0 the first, of image 1 the second,
                                                                           and so on; after the last, the first again
=============  ==========================================================  ===========================================
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Protocol, TypeGuard

import numpy as np

KINDS = ("uniform", "normal", "lognormal", "integers", "choice", "sequence")
_STANDARD = NormalDist()
Scalar = float | int | str | bool | None


class Distribution(Protocol):
    """Something that can be drawn from."""

    def draw(self, rng: np.random.Generator) -> Scalar: ...

    def extremes(self) -> tuple[Scalar, ...]:
        """Values to try against the schema: the ends, or every choice; an unbounded side has none."""
        ...


class BadDistributionError(ValueError):
    """What a distribution's parameters should be; the loader adds the place."""


def is_distribution(value: object) -> TypeGuard[Mapping[str, Any]]:
    """Whether `value` is written as a distribution: a mapping with the one key uniform, normal, ..."""
    return isinstance(value, Mapping) and len(value) == 1 and next(iter(value)) in KINDS


def parse_distribution(value: Mapping[str, Any]) -> Distribution:
    """The distribution written as `value`; raises `BadDistributionError` that says what was expected."""
    kind, parameters = next(iter(value.items()))
    return _PARSERS[kind](parameters)


@dataclass(frozen=True)
class Uniform:
    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        return float(rng.uniform(self.low, self.high))

    def extremes(self) -> tuple[float, ...]:
        return (self.low, self.high)


@dataclass(frozen=True)
class Integers:
    low: int
    high: int

    def draw(self, rng: np.random.Generator) -> int:
        return int(rng.integers(self.low, self.high, endpoint=True))

    def extremes(self) -> tuple[int, ...]:
        return (self.low, self.high)


@dataclass(frozen=True)
class Choice:
    values: tuple[Scalar, ...]

    def draw(self, rng: np.random.Generator) -> Scalar:
        return self.values[int(rng.integers(len(self.values)))]

    def extremes(self) -> tuple[Scalar, ...]:
        return self.values


@dataclass(frozen=True)
class Sequence:
    """Not random: each image has its own value, such as a time of a story."""

    values: tuple[Scalar, ...]

    def of_image(self, image: int) -> Scalar:
        return self.values[image % len(self.values)]

    def draw(self, rng: np.random.Generator) -> Scalar:
        """For whoever knows no image: the first."""
        return self.values[0]

    def extremes(self) -> tuple[Scalar, ...]:
        return self.values


@dataclass(frozen=True)
class Normal:
    """Gaussian, truncated to [low, high]; of the logarithm if `log`, bounds then being those of the value itself."""

    mean: float  # of the logarithm, if `log`
    sd: float
    low: float
    high: float
    log: bool = False

    def _standard_bounds(self) -> tuple[float, float]:
        low, high = (self.low, self.high) if not self.log else (_log(self.low), _log(self.high))
        return (low - self.mean) / self.sd, (high - self.mean) / self.sd

    def mass(self) -> float:
        """Probability that the untruncated distribution lies within the bounds."""
        a, b = self._standard_bounds()
        # The upper tail is as precise as the lower one only when it is read mirrored.
        return _below(-a) - _below(-b) if a > 0 else _below(b) - _below(a)

    def draw(self, rng: np.random.Generator) -> float:
        a, b = self._standard_bounds()
        sign = -1.0 if a > 0 else 1.0
        lower, upper = sorted((_below(sign * a), _below(sign * b)))
        u = lower + (upper - lower) * (1.0 - rng.random())  # (lower, upper]: never -infinity
        z = sign * _STANDARD.inv_cdf(min(u, math.nextafter(1.0, 0.0)))
        value = self.mean + self.sd * z
        return min(max(math.exp(min(value, 700.0)) if self.log else value, self.low), self.high)

    def extremes(self) -> tuple[float, ...]:
        middle = math.exp(self.mean) if self.log else self.mean
        ends = [end for end in (self.low, self.high) if math.isfinite(end) and not (self.log and end == 0)]
        return (min(max(middle, self.low), self.high), *ends)


def _below(z: float) -> float:
    """Probability of a standard Gaussian below `z`; unlike NormalDist.cdf precise in the lower tail."""
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


def _log(value: float) -> float:
    return math.log(value) if value > 0 else -math.inf


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(_to_float(value))


def _to_float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _pair(value: Any, expected: str) -> tuple[float, float]:
    if not (isinstance(value, list | tuple) and len(value) == 2 and all(_is_number(v) for v in value)):
        raise BadDistributionError(expected)
    return value[0], value[1]


def _uniform(value: Any) -> Uniform:
    low, high = map(float, _pair(value, "{uniform: [low, high]} with two numbers"))
    if low > high or not math.isfinite(high - low):
        raise BadDistributionError("{uniform: [low, high]} with low at most high")
    return Uniform(low, high)


def _integers(value: Any) -> Integers:
    low, high = _pair(value, "{integers: [low, high]} with two whole numbers")
    if low != int(low) or high != int(high) or low > high or max(abs(low), abs(high)) >= 2**63:
        raise BadDistributionError("{integers: [low, high]} with whole numbers, low at most high")
    return Integers(int(low), int(high))


def _choice(value: Any) -> Choice:
    return Choice(_values(value, "choice"))


def _sequence(value: Any) -> Sequence:
    return Sequence(_values(value, "sequence"))


def _values(value: Any, kind: str) -> tuple[Scalar, ...]:
    if not isinstance(value, list | tuple) or not 1 <= len(value) <= 10_000:
        raise BadDistributionError(f"{{{kind}: [x, y, ...]}} with 1 to 10000 values")
    if not all(v is None or isinstance(v, str | bool) or _is_number(v) for v in value):
        raise BadDistributionError(
            f"{{{kind}: [x, y, ...]}} of finite numbers, texts, true or false, not lists or mappings"
        )
    return tuple(value)


def _gaussian(value: Any, kind: str, centre: str, spread: str) -> tuple[float, float, float, float]:
    """Centre, spread, low, high of a normal or lognormal, however written."""
    expected = f"{{{kind}: [{centre}, {spread}]}} or {{{kind}: {{{centre}: , {spread}: , low: , high: }}}} with numbers"
    low, high = -math.inf, math.inf
    if isinstance(value, Mapping):
        if not {centre, spread} <= value.keys() <= {centre, spread, "low", "high"}:
            raise BadDistributionError(expected)
        if not all(_is_number(v) for v in value.values()):
            raise BadDistributionError(expected)
        middle, width = float(value[centre]), float(value[spread])
        low, high = float(value.get("low", low)), float(value.get("high", high))
    else:
        middle, width = map(float, _pair(value, expected))
    if width <= 0:
        raise BadDistributionError(f"{spread} greater than 0")
    if low >= high:
        raise BadDistributionError("low less than high")
    return middle, width, low, high


def _normal(value: Any) -> Normal:
    return _with_mass(Normal(*_gaussian(value, "normal", "mean", "sd")))


def _lognormal(value: Any) -> Normal:
    median, sigma, low, high = _gaussian(value, "lognormal", "median", "sigma")
    if median <= 0 or sigma > 50 or high <= 0:
        raise BadDistributionError("{lognormal: [median, sigma]} with median greater than 0 and sigma up to 50")
    return _with_mass(Normal(math.log(median), sigma, max(low, 0.0), high, log=True))


def _with_mass(normal: Normal) -> Normal:
    if normal.mass() < 1e-9:
        raise BadDistributionError("low and high where the distribution has more than a billionth of its mass")
    return normal


_PARSERS: dict[str, Callable[[Any], Distribution]] = {
    "uniform": _uniform,
    "normal": _normal,
    "lognormal": _lognormal,
    "integers": _integers,
    "choice": _choice,
    "sequence": _sequence,
}
