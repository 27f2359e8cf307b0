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
choice         ``{choice: [x, y, ...]}``,                                  one of them, equally likely or as the weights
               ``{choice: {values: [x, y, ...], weights: [3, 1, ...]}}``   say: numbers, texts, mappings or lists, in
                                                                           which there may be distributions again
sequence       ``{sequence: [x, y, ...]}``                                 of image 0 the first, of image 1 the second,
                                                                           and so on; after the last, the first again
=============  ==========================================================  ===========================================

Each has a quantile function, so that a value can follow from a point of [0, 1) that was placed with others in mind
(`forestgen.recipe.sampler`); `draw` takes an independent one.
"""

from __future__ import annotations

import math
import sys
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from statistics import NormalDist
from typing import Any, Protocol, TypeGuard

import numpy as np

MOST_VALUES = 10_000
KINDS = ("uniform", "normal", "lognormal", "integers", "choice", "sequence")
_STANDARD = NormalDist()
Scalar = float | int | str | bool | None


class Distribution(Protocol):
    """Something that can be drawn from."""

    def draw(self, rng: np.random.Generator) -> Scalar: ...

    def quantile(self, u: float) -> Scalar:
        """The value below which a share u of all draws lies, 0 <= u < 1; of a choice, in the order written."""
        ...

    def extremes(self) -> tuple[Scalar, ...]:
        """Values to try against the schema: the ends, or every choice; an unbounded side has none."""
        ...


class BadDistributionError(ValueError):
    """What a distribution's parameters should be; the loader adds the place."""

    def __init__(self, expected: str, hint: str | None = None) -> None:
        super().__init__(expected)
        self.hint = hint


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

    def quantile(self, u: float) -> float:
        return min(self.low + (self.high - self.low) * u, self.high)

    def extremes(self) -> tuple[float, ...]:
        return (self.low, self.high)


@dataclass(frozen=True)
class Integers:
    low: int
    high: int

    def draw(self, rng: np.random.Generator) -> int:
        return int(rng.integers(self.low, self.high, endpoint=True))

    def quantile(self, u: float) -> int:
        return min(self.low + int((self.high - self.low + 1) * u), self.high)

    def extremes(self) -> tuple[int, ...]:
        return (self.low, self.high)


@dataclass(frozen=True)
class Choice:
    """One of some values. If any is a mapping or a list, `numbered`: a draw is then the number of an entry, from 0.

    The loader puts that entry in place, for it may hold distributions.
    """

    values: tuple[Any, ...]
    weights: tuple[float, ...] | None = None  # above 0; None: equally likely
    numbered: bool = False

    @cached_property
    def _ends(self) -> tuple[float, ...]:
        """Of each value's share of [0, 1); the last is 1."""
        weights = self.weights or (1.0,) * len(self.values)
        total = math.fsum(weights)
        return (*(end / total for end in accumulate(weights[:-1])), 1.0)

    def draw(self, rng: np.random.Generator) -> Scalar:
        if self.weights is None:
            return self._value(int(rng.integers(len(self.values))))
        return self.quantile(rng.random())

    def quantile(self, u: float) -> Scalar:
        return self._value(min(bisect_right(self._ends, u), len(self.values) - 1))

    def extremes(self) -> tuple[Scalar, ...]:
        return tuple(self._value(number) for number in range(len(self.values)))

    def _value(self, number: int) -> Scalar:
        if self.numbered:
            return number
        value: Scalar = self.values[number]
        return value


@dataclass(frozen=True)
class Sequence:
    """Not random: each image has its own value, such as a time of a timeline."""

    values: tuple[Scalar, ...]

    def of_image(self, image: int) -> Scalar:
        return self.values[image % len(self.values)]

    def draw(self, rng: np.random.Generator) -> Scalar:
        """The first; for callers without an image."""
        return self.values[0]

    def quantile(self, u: float) -> Scalar:
        """Of the values as if they were drawn."""
        return self.values[min(int(u * len(self.values)), len(self.values) - 1)]

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
        return self._at(1.0 - rng.random())

    def quantile(self, u: float) -> float:
        return self._at(1.0 - u if self._standard_bounds()[0] > 0 else u)

    def _at(self, share: float) -> float:
        """Value at a share of the mass within the bounds, counted from the longer tail: from above if low > mean."""
        a, b = self._standard_bounds()
        sign = -1.0 if a > 0 else 1.0
        lower, upper = sorted((_below(sign * a), _below(sign * b)))
        u = lower + (upper - lower) * share
        z = sign * _STANDARD.inv_cdf(min(max(u, math.ulp(0.0)), math.nextafter(1.0, 0.0)))
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
    """Whether this is a number that a float can hold."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


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
    if not isinstance(value, Mapping):
        values = _entries(value)
        return Choice(values, None, _is_structured(values))
    if value.keys() != {"values", "weights"}:
        expected = "{choice: [x, y, ...]} or {choice: {values: [x, y, ...], weights: [3, 1, ...]}}"
        raise BadDistributionError(expected, _weights_hint(value))
    values, weights = _entries(value["values"]), value["weights"]
    if not isinstance(weights, list | tuple) or len(weights) != len(values):
        raise BadDistributionError(f"as many weights as values: {len(values)}")
    if not all(_is_number(weight) and 0 <= weight <= 1e100 for weight in weights) or not any(weights):
        raise BadDistributionError("weights of 0 and more, not all of them 0")
    # What is never drawn stays among the values of a numbered choice, whose draws are its entries' numbers.
    if not all(weights) and _is_structured(values):
        raise BadDistributionError("weights above 0", "leave out the mapping or list that is never to be drawn")
    kept = [(one, float(weight)) for one, weight in zip(values, weights, strict=True) if weight > 0]
    return Choice(tuple(one for one, _ in kept), tuple(weight for _, weight in kept), _is_structured(values))


def _weights_hint(value: Mapping[str, Any]) -> str | None:
    """What a mapping of values to their weights would be here."""
    if not value or len(value) > 9 or not all(_is_number(weight) for weight in value.values()):
        return None
    weights = ", ".join(f"{weight:g}" for weight in value.values())
    return f"{{choice: {{values: [{', '.join(map(str, value))}], weights: [{weights}]}}}}"


def _is_structured(values: tuple[Any, ...]) -> bool:
    return any(isinstance(value, Mapping | list | tuple) for value in values)


def _entries(value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple) or not 1 <= len(value) <= MOST_VALUES:
        raise BadDistributionError(f"{{choice: [x, y, ...]}} with 1 to {MOST_VALUES} values")
    if not all(_is_scalar(one) or isinstance(one, Mapping | list | tuple) for one in value):
        raise BadDistributionError("{choice: [x, y, ...]} of finite numbers, texts, true or false, mappings or lists")
    return tuple(value)


def _sequence(value: Any) -> Sequence:
    if not isinstance(value, list | tuple) or not 1 <= len(value) <= MOST_VALUES:
        raise BadDistributionError(f"{{sequence: [x, y, ...]}} with 1 to {MOST_VALUES} values")
    if not all(_is_scalar(one) for one in value):
        expected = "{sequence: [x, y, ...]} of finite numbers, texts, true or false, not lists or mappings"
        raise BadDistributionError(expected)
    return Sequence(tuple(value))


def _is_scalar(value: object) -> bool:
    return value is None or isinstance(value, str | bool) or _is_number(value)


def _gaussian(value: Any, kind: str, centre: str, spread: str) -> tuple[float, float, float, float]:
    """Centre, spread, low, high of a normal or lognormal, however written."""
    expected = f"{{{kind}: [{centre}, {spread}]}} or {{{kind}: {{{centre}: , {spread}: , low: , high: }}}} with numbers"
    low, high = -math.inf, math.inf
    if isinstance(value, Mapping):
        known = {centre, spread} <= value.keys() <= {centre, spread, "low", "high"}
        if not known or not all(_is_number(v) for v in value.values()):
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
    "uniform": _uniform, "normal": _normal, "lognormal": _lognormal, "integers": _integers, "choice": _choice,
    "sequence": _sequence,
}  # fmt: skip
