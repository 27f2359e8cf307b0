"""Deformation kernels: how a plant changes the probability of finding another one at a distance.

κ(d) multiplies the probability field at a distance d from a plant: 0 bars, 1 leaves as it is, above 1 invites. Beyond
the kernel's reach κ is 1. The page of `models/deformation_kernel.py` has all forms of a recipe.

Reference: Lane 2002, section 5.1, Figures 5.1, 5.2, 5.4 and 5.7.
"""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, TypeAdapter, WrapValidator, field_serializer, model_validator

from forestgen.community.population import Floats, Site
from forestgen.core.errors import RecipeError
from forestgen.recipe.curves import Curve, Formula, Function, Smooth, evaluate
from forestgen.recipe.fields import Flag, Name, Number, Positive, Section, violation
from forestgen.recipe.sources import Keys, dotted

SAMPLES = 1024  # of a kernel's table; κ is linear between them
GREATEST = 1e6  # of κ: what one plant may multiply a field by, which is scaled between plants lest it overflow
GREATEST_REACH = 1e4  # radii or metres
LEAST_HOPKINS, MOST_HOPKINS = 0.4, 10.0

KernelName = Literal["inhibition", "neutral", "weak_clustering", "clustering"]

#: The kernels that a recipe may name, those of Figures 5.2 and 5.4. Distances are in radii of the plant. Among equal
#: plants with a radius of 0.75 of their mean spacing (the root of the area a plant) they have the Hopkins indices
#: 0.47, 1.0, 1.2 and 2.4; see tests/system/test_reproductions_placement.py.
NAMED: dict[str, dict[str, Any]] = {
    "inhibition": {"curve": [[0, 0], [1, 0], [1.1, 1]]},
    "neutral": {"curve": 1.0, "reach": 1.0},
    "weak_clustering": {"curve": [[0, 0], [0.2, 0], [0.4, 1.9], [1.2, 0.6], [3, 1]]},
    "clustering": {"curve": [[0, 0], [0.2, 0], [0.3, 3.6], [1.2, 0.5], [3, 1]]},
}


class KernelSection(Section):
    """One kernel."""

    curve: Curve = Field(description="κ by distance: a number, points, {smooth: points} or {formula: text}; >= 0.")
    reach: Positive | None = Field(
        None,
        le=GREATEST_REACH,
        description="Distance beyond which κ is 1; null: that of the last point. A formula needs one.",
    )
    distance: Literal["radii", "metres"] = Field(
        "radii", description="What distances count in: radii of the plant that deforms, or metres."
    )
    balanced: Flag = Field(
        False,
        description="Whether κ is scaled, plant by plant, so that the field's sum within reach stays: probability is "
        "moved about, none is made or taken, and numbers keep to the map on areas larger than the reach.",
    )

    @field_serializer("curve")
    def _as_written(self, curve: Function) -> Any:
        if isinstance(curve, Formula):
            return {"formula": curve.text}
        if isinstance(curve, Smooth):
            return {"smooth": curve.points}
        return curve[0][1] if len(curve) == 1 else curve

    @model_validator(mode="after")
    def _has_a_reach(self) -> Self:
        points: Any = () if isinstance(self.curve, Formula) else _points(self.curve)
        unit = "radii of the plant" if self.distance == "radii" else "metres"
        if self.reach is None and len(points) < 2:
            expected, hint = "reach, the distance beyond which κ is 1", f"reach: 3 is three {unit}"
            raise _wrong_curve(expected, problem="this kernel does not end", hint=hint)
        if len(points) > 1 and (points[0][0] < 0 or points[-1][0] <= 0):
            got = f"{points[0][0]:g}"
            raise _wrong_curve("positions from 0 on", problem="a distance is not negative", got=got)
        if self.reach is None and points[-1][0] > GREATEST_REACH:
            expected, got = f"a last point at {GREATEST_REACH:g} at most", f"{points[-1][0]:g}"
            raise _wrong_curve(expected, problem="this kernel reaches too far", got=got)
        return self

    @model_validator(mode="after")
    def _has_values_that_a_field_can_take(self) -> Self:
        values = table(self).values
        if values.min() < 0:
            problem = "a kernel multiplies probabilities, which are never negative"
            hint = "0 bars plants, 1 leaves the field as it is"
            raise _wrong_curve("values of 0 and more", problem=problem, got=f"{values.min():g}", hint=hint)
        if values.max() > GREATEST:
            expected, got = f"values from 0 to {GREATEST:g}", f"{values.max():g}"
            raise _wrong_curve(expected, problem="this kernel is too strong", got=got)
        if self.balanced and not values.any():
            raise _wrong_curve(
                "a kernel that is above 0 somewhere within its reach",
                problem="a balanced kernel moves probability about, and this one leaves it no place",
                hint="enlarge reach, or leave balanced out",
            )
        return self


_wrong_curve = partial(violation, at=("curve",))


class HopkinsTarget(Section):
    """How clustered all plants together are to be; the model finds the kernel. 1: at random; more: in clusters."""

    hopkins: Number = Field(
        ge=LEAST_HOPKINS,
        le=MOST_HOPKINS,
        description=f"Hopkins index, {LEAST_HOPKINS:g} (as on a lattice) to {MOST_HOPKINS:g} (tight clusters).",
    )


_KERNEL_KEYS = tuple(KernelSection.model_fields)
_KERNEL_FORMS = f"a kernel's name ({', '.join(NAMED)}) or {{curve: ...}}"


def _named(value: Any, check: Callable[[Any], Any]) -> Any:
    if isinstance(value, KernelSection):
        return value
    if isinstance(value, str):
        if value not in NAMED:
            near = difflib.get_close_matches(value, NAMED, n=1)
            expected, hint = f"{', '.join(NAMED)}, or {{curve: ...}}", f"did you mean {near[0]!r}?" if near else None
            raise violation(expected, problem="no such kernel", got=repr(value[:60]), hint=hint)
        return _sections[value]
    if not isinstance(value, Mapping):
        hint = "write {curve: ...}" if isinstance(value, int | float | list | tuple) else None
        raise violation(_KERNEL_FORMS, problem="this is no kernel", hint=hint)
    return check(value)


#: A kernel in a recipe: its name, or a section.
Kernel = Annotated[KernelSection, WrapValidator(_named, json_schema_input_type=KernelName | KernelSection)]
_kernel: TypeAdapter[KernelSection] = TypeAdapter(Kernel)
_row: TypeAdapter[dict[str, KernelSection]] = TypeAdapter(dict[Name, Kernel])
_target = TypeAdapter(HopkinsTarget)


def _is_kernel(value: Any) -> bool:
    """Whether this is to be one kernel, rather than kernels by species."""
    return not isinstance(value, Mapping) or any(key in _KERNEL_KEYS for key in value)


def _read_row(value: Any) -> Any:
    return _kernel.validate_python(value) if _is_kernel(value) else _row.validate_python(value)


_matrix: TypeAdapter[dict[str, Any]] = TypeAdapter(dict[Name, Annotated[Any, BeforeValidator(_read_row)]])


def _read(value: Any, _: Any) -> Any:
    """One kernel, a target, or a kernel matrix: its keys say which, so that errors are about the form meant."""
    if isinstance(value, KernelSection | HopkinsTarget):
        return value
    if isinstance(value, Mapping) and "hopkins" in value:
        others = [key for key in value if key != "hopkins"]
        if others:
            raise violation(
                "hopkins alone", problem="a target has no further keys", got=str(others[0]), at=(others[0],)
            )
        return _target.validate_python(value)
    if _is_kernel(value):
        if value is None:
            raise violation(f"{_KERNEL_FORMS}, {{hopkins: ...}}, or kernels by species", problem="kernels says nothing")
        return _kernel.validate_python(value)
    for key, inside in value.items():
        near = difflib.get_close_matches(str(key), (*_KERNEL_KEYS, "hopkins"), n=1, cutoff=0.7)
        if near and not isinstance(inside, str | Mapping):
            expected = f"{', '.join(_KERNEL_KEYS)}, hopkins, or a species"
            raise violation(expected, problem=f"unknown key {str(key)!r}", hint=f"did you mean {near[0]!r}?", at=(key,))
    return _matrix.validate_python(value)


Row = dict[Name, Kernel]  # by the species that is affected
#: What a recipe says of all kernels. By species: of those that act, and within, of those that are affected.
Kernels = Annotated[
    KernelSection | HopkinsTarget | dict[Name, KernelSection | dict[Name, KernelSection]],
    WrapValidator(_read, json_schema_input_type=KernelName | KernelSection | HopkinsTarget | dict[Name, Kernel | Row]),
]


def each_kernel(kernels: object) -> Iterator[tuple[Keys, KernelSection]]:
    """Every kernel of a recipe with the keys that lead to it: none, the acting species, or it and the affected one."""
    if isinstance(kernels, KernelSection):
        yield (), kernels
    elif isinstance(kernels, Mapping):
        for key, inside in kernels.items():
            yield from (((key, *keys), one) for keys, one in each_kernel(inside))


def species_named(kernels: object) -> Iterator[tuple[Keys, str]]:
    """Key path within `kernels`, and name, of every species that a recipe's kernels speak of."""
    if isinstance(kernels, Mapping):
        for acting, row in kernels.items():
            yield (acting,), acting
            if isinstance(row, Mapping):
                yield from (((acting, affected), affected) for affected in row)


def _points(curve: Any) -> Any:
    return curve.points if isinstance(curve, Smooth) else curve


@dataclass(frozen=True)
class KernelTable:
    """A kernel as every algorithm reads it: κ at evenly spaced distances from 0 to its reach, linear between them."""

    values: Floats  # (SAMPLES + 1,)
    reach: float  # in radii of the plant, or in metres
    in_radii: bool
    balanced: bool = False

    def reach_m(self, radius_m: Floats | float) -> Floats:
        """Distance beyond which a plant of this radius has no effect, metres, of the radius' shape."""
        radius = np.asarray(radius_m, dtype=np.float64)
        return self.reach * radius if self.in_radii else np.full(radius.shape, self.reach)

    def __call__(self, distance_m: Floats, radius_m: float) -> Floats:
        """κ at distances of any shape from a plant of one radius; plain, for tests and plots."""
        reach_m = float(self.reach_m(radius_m))
        at = np.asarray(distance_m, dtype=np.float64) / reach_m
        inside = np.interp(at, np.linspace(0.0, 1.0, len(self.values)), self.values)
        return np.where(at <= 1.0, inside, 1.0)

    @cached_property
    def is_neutral(self) -> bool:
        return bool(np.all(self.values == 1.0))


@lru_cache(maxsize=1024)
def table(kernel: KernelSection) -> KernelTable:
    """The kernel's table; the same object for the same kernel, as a matrix of many species repeats a few."""
    reach = kernel.reach if kernel.reach is not None else float(_points(kernel.curve)[-1][0])
    values = evaluate(kernel.curve, np.linspace(0.0, reach, SAMPLES + 1))
    return KernelTable(values, reach, kernel.distance == "radii", kernel.balanced)


NEUTRAL = KernelTable(np.ones(SAMPLES + 1), 1.0, in_radii=True)
#: Made once: a matrix of many species names a few kernels many times.
_sections = {name: KernelSection(**keys) for name, keys in NAMED.items()}


def kernel_matrix(
    kernels: KernelSection | Mapping[str, KernelSection | Mapping[str, KernelSection]], species: Sequence[str]
) -> list[list[KernelTable]]:
    """Tables of the kernels of some species: [i][j] is the effect of a plant of species j on the field of species i.

    A recipe has them the other way round, by who acts (j), then by who is affected (i); what it leaves out is neutral.
    Lane 2002, section 5.4, M_ij.
    """
    found = [[_effect(kernels, acting, affected) for acting in species] for affected in species]
    return [[NEUTRAL if one is None else table(one[1]) for one in row] for row in found]


def refuse_long_work(
    kernels: object,
    site: Site,
    acting: Mapping[str, tuple[float, float]],
    affected: Mapping[str, float],
    most: float,
    words: tuple[str, str, str],
) -> None:
    """Raise `RecipeError`, at the kernel that costs most, for more than `most` of what plants affect within reach.

    `acting` is by species the number of plants, and their radius in metres; `affected` is by species what there is of
    it on the whole site, such as cells or plants. `words` say what is at most expected, what is got, and what helps.
    """
    costs = []
    for (actor, (plants, radius_m)), (other, there) in itertools.product(acting.items(), affected.items()):
        found = _effect(kernels, actor, other)
        if found is not None and plants * there > 0.0:
            keys, section = found
            reach_m = 0.0 if table(section).is_neutral else float(table(section).reach_m(radius_m))
            costs.append((plants * there * min(1.0, math.pi * reach_m**2 / site.area_m2), reach_m, keys))
    total, (expected, got, hint) = sum(cost for cost, _, _ in costs), words
    if total > most:
        _, reach_m, keys = max(costs, key=lambda one: one[0])
        raise RecipeError(
            f"this would take too long: plants act by this kernel at up to {reach_m:.3g} m",
            where=dotted(("community", "kernels", *keys)),
            expected=f"at most {most:.0e} {expected}",
            got=f"{total:.1e}: {got}",
            hint=f"a shorter reach, {hint}",
        )


def _effect(kernels: object, acting: str, affected: str) -> tuple[Keys, KernelSection] | None:
    """The kernel of one species on another, and its keys; None: there is none, which is neutral."""
    if isinstance(kernels, KernelSection):
        return (), kernels
    row = kernels.get(acting) if isinstance(kernels, Mapping) else None
    if isinstance(row, KernelSection):
        return (acting,), row
    return ((acting, affected), row[affected]) if row is not None and affected in row else None
