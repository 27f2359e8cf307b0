"""What an instrument is: a measurement in a recipe's scene that is not a picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Generic, TypeVar

from pydantic import AllowInfNan, BeforeValidator, ValidationError

from forestgen.core.arguments import listed, shown
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress, Timings
from forestgen.recipe.cameras import DIRECTIONS
from forestgen.recipe.fields import Section, violation
from forestgen.recipe.load import LoadedRecipe
from forestgen.recipe.messages import Explainer
from forestgen.recipe.sources import Place, SourceMap
from forestgen.scene.build import BuiltScene
from forestgen.scene.plan import Plan

Point = tuple[float, float, float]


class Reading:
    """What an instrument measured."""

    def lines(self) -> Iterator[str]:
        """For people."""
        raise NotImplementedError

    def content(self, ending: str, loaded: LoadedRecipe) -> bytes:
        """Of a file for programs, by one of the instrument's `endings`; `loaded` is the recipe that was measured."""
        raise NotImplementedError

    def __str__(self) -> str:
        return "\n".join(self.lines())


KeysT = TypeVar("KeysT", bound=Section)
ReadingT = TypeVar("ReadingT", bound=Reading, covariant=True)


class Instrument(Generic[KeysT, ReadingT]):
    """A measurement. It has no state."""

    name: str  # that calls and commands use: the registry's
    Parameters: type[KeysT]  # keys of a measurement
    endings: tuple[str, ...] = (".json",)  # of files that its readings are written to

    def check(self, plan: Plan, keys: KeysT) -> None:
        """Raise `RecipeError` for what can be known to be wrong before anything is simulated."""

    def measure(self, scene: BuiltScene, keys: KeysT, progress: Progress, timings: Timings) -> ReadingT:
        """Measure in the scene of a recipe's first image.

        Raises `RecipeError`: it cannot be measured there.
        """
        raise NotImplementedError


def read_keys(instrument: Instrument[KeysT, Any], values: Mapping[str, Any]) -> KeysT:
    """The keys of a measurement.

    Raises `RecipeError`: what is wrong with the first one, by its name.
    """
    values = {key: value.tolist() if hasattr(value, "tolist") else value for key, value in values.items()}  # of NumPy
    try:
        return instrument.Parameters.model_validate(values)
    except ValidationError as failure:
        sources = SourceMap({(): Place(instrument.name)})
        error = Explainer(instrument.Parameters, values, sources).error(failure).errors[0]
        key = (error.where or "").rpartition(": ")[2].partition(".")[0] or None
        raise RecipeError(
            error.problem, parameter=key, expected=error.expected, got=error.got, hint=error.hint
        ) from None


def point_of(values: Sequence[float | str]) -> Point:
    """A point of three numbers, metres, whose place is not checked. Raises `RecipeError`."""
    try:
        x, y, z = (float(one) for one in values)
    except (TypeError, ValueError, OverflowError):
        several = values if isinstance(values, list | tuple) else [values]
        got = " ".join(f"{one:.100}" if isinstance(one, str) else shown(one) for one in several)
        raise RecipeError("this is no point", expected="three numbers, metres, such as 30 40 1.5", got=got) from None
    return x, y, z


def direction_of(direction: str | Sequence[float]) -> Point:
    """Unit vector of a direction, by its name or its components. Raises `RecipeError`."""
    if isinstance(direction, str) and direction.lower() in DIRECTIONS:
        return DIRECTIONS[direction.lower()]
    try:
        x, y, z = (float(one) for one in (direction.split(",") if isinstance(direction, str) else direction))
        length = math.sqrt(x * x + y * y + z * z)
    except (TypeError, ValueError, OverflowError):
        length = math.nan
    if not (math.isfinite(length) and length > 1e-9):
        expected = ", ".join(DIRECTIONS) + ", or x,y,z such as 0,0.5,1"
        got = direction if isinstance(direction, str) else shown(direction)
        raise RecipeError("this is no direction", expected=expected, got=got)
    return x / length, y / length, z / length


def _key(read: Callable[[Any], Any]) -> BeforeValidator:
    """A validator of a key that `read` reads."""

    def validated(value: Any) -> Any:
        try:
            return read(value)
        except RecipeError as error:
            raise violation(error.expected or "", problem=error.problem, got=error.got, hint=error.hint) from error

    return BeforeValidator(validated)


_Metres = Annotated[float, AllowInfNan(True)]  # whether it lies on the site is checked with the site
PointKey = Annotated[tuple[_Metres, _Metres, _Metres], _key(point_of)]
DirectionKey = Annotated[Point, _key(direction_of)]
PointsKey = Annotated[tuple[PointKey, ...], _key(lambda value: tuple(listed(value, "at", "points")))]
DirectionsKey = Annotated[tuple[DirectionKey, ...], _key(lambda value: tuple(listed(value, "normals", "directions")))]
