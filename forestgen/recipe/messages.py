"""Turns the schema library's errors into messages for people: where, expected, got, what to do."""

from __future__ import annotations

import difflib
import re
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

from forestgen.core.errors import RecipeError, RecipeErrors
from forestgen.recipe.distributions import KINDS, is_distribution
from forestgen.recipe.fields import LABEL_PATTERN, NAME_PATTERN
from forestgen.recipe.sources import Keys, SourceMap
from forestgen.recipe.suggestions import did_you_mean

UNDRAWN: tuple[Keys, ...] = (
    ("forestgen",), ("seed",), ("images",), ("first_image",), ("same_stand",), ("sampling",), ("dataset", "splits"),
)  # fmt: skip

_SIMPLE = {
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    "int_parsing_size": "a whole number of reasonable size",
    "finite_number": "a finite number",
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "text",
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    "dict_type": "a mapping of names to values",
    **dict.fromkeys(("model_type", "model_attributes_type"), "a mapping of keys to values"),
    "none_required": "null",
}
_WITH_CONTEXT: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "greater_than": lambda c: f"a number greater than {c['gt']:g}",
    "greater_than_equal": lambda c: f"a number of at least {c['ge']:g}",
    "less_than": lambda c: f"a number less than {c['lt']:g}",
    "less_than_equal": lambda c: f"a number of at most {c['le']:g}",
    "multiple_of": lambda c: f"a multiple of {c['multiple_of']:g}",
    "literal_error": lambda c: f"{c['expected']}",
    "enum": lambda c: f"{c['expected']}",
    "too_short": lambda c: f"at least {c['min_length']} {'entry' if c['min_length'] == 1 else 'entries'}",
    "too_long": lambda c: f"at most {c['max_length']} entries",
    "string_too_short": lambda c: f"text of at least {c['min_length']} characters",
    "string_too_long": lambda c: f"text of at most {c['max_length']} characters",
    "value_error": lambda c: f"{c['error']}",
    "assertion_error": lambda c: f"{c['error']}",
}
_WITH_UNIT = re.compile(r"([-+]?[0-9.]+(?:e[-+]?[0-9]+)?)\s*([^\s0-9].*)", re.IGNORECASE)
#: Ends of keys -> names of their unit: first for people, then as it is written.
_UNITS = {
    "_m2": "square metres, m2, m²",
    "_m": "metres, m, metre, meter, meters",
    "_deg": "degrees, deg, °, degree",
    "_yr": "years, yr, y, a, year",
    "_px": "pixels, px, pixel",
    "_nm": "nanometres, nm",
    "_mm": "millimetres, mm",
    "_um": "micrometres, um, µm",
    "_c": "degrees Celsius, C, °C",
    "_k": "kelvins, K",
    "_s": "seconds, s, sec",
    "_kg": "kilograms, kg",
}
_NUMBER_TYPES = {"float_type", "float_parsing", "int_type", "int_parsing", "finite_number"}
_ABSENT = object()


def show(value: object) -> str:
    """A value as YAML would have it, on one short line."""
    text = _yaml(value, 0)
    return text if len(text) <= 80 else text[:77] + "..."


def _yaml(value: object, depth: int) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        inside = ", ".join(f"{k}: {_yaml(v, depth + 1)}" for k, v in list(value.items())[:9]) if depth < 3 else "..."
        return f"{{{inside}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_yaml(v, depth + 1) for v in value[:9])}]" if depth < 3 else "[...]"
    if isinstance(value, int) and abs(value) >= 10**60:
        return "a whole number of more than 60 digits"
    return repr(value)[:200]


def distribution_of(keys: Keys, written: Mapping[Keys, Any]) -> Any:
    """The distribution, as written, that the value at `keys` was drawn from; None: it was not drawn."""
    found = (written.get(keys[:n]) for n in range(len(keys), 0, -1))
    return next((one for one in found if one is not None), None)


@dataclass(frozen=True)
class Explainer:
    """Explains what a model found wrong with data.

    Parameters
    ----------
    model : the class that rejected the data.
    data : what it rejected.
    sources : where the recipe's keys are.
    prefix : key path of `data` in the recipe.
    written : distribution, as written, by key path, of those values that were drawn.
    """

    model: type[BaseModel]
    data: Mapping[str, Any]
    sources: SourceMap
    prefix: Keys = ()
    written: Mapping[Keys, Any] | None = None

    def error(self, failure: ValidationError) -> RecipeError:
        """One error that holds all that was found."""
        by_place: dict[tuple[str | None, str], RecipeError] = {}
        for details in failure.errors(include_url=False):
            found = self._explained(details)
            by_place.setdefault((found.where, found.problem), found)
        errors = list(by_place.values())
        return errors[0] if len(errors) == 1 else RecipeErrors(errors)

    def _explained(self, details: Any) -> RecipeError:
        kind, value, context = details["type"], details["input"], details.get("ctx", {})
        keys: Keys = tuple(k for k in details["loc"] if k != "[key]")
        if kind == "extra_forbidden":
            return self._unknown_key(keys)
        if kind in ("missing", "too_long") and self._tuple_length(keys, kind):
            keys = keys[:-1] if kind == "missing" else keys
            return self._at(keys, "bad value", f"a list of {self._tuple_length(keys, 'too_long')} entries", show(value))
        if kind == "missing":
            return self._missing(keys)
        if kind in ("union_tag_invalid", "union_tag_not_found"):
            return self._which_form(keys, value, str(context["discriminator"]).strip("'"))
        keys = self._written_keys(keys, existing=True)
        if kind == "violation":
            got = context["got"] or show(value)
            return self._at(keys + tuple(context["at"]), context["problem"], context["expected"], got, context["hint"])
        expected = expectation(kind, context, details["msg"])
        hint = self._number_hint(keys, value) if kind in _NUMBER_TYPES else None
        if kind in ("literal_error", "enum") and isinstance(value, str):
            hint = did_you_mean(value, re.findall(r"'([^']*)'", expected), cutoff=0.5)
        elif kind in ("list_type", "tuple_type"):
            length = self._tuple_length(keys, "too_long")
            expected = expected if length is None else f"a list of {length} entries"
            expected = "[width, height], pixels" if keys and keys[-1] == "size_px" else expected
        return self._at(keys, "bad value", expected, show(value), hint)

    def _at(self, keys: Keys, problem: str, expected: str, got: str, hint: str | None = None) -> RecipeError:
        full = self.prefix + keys
        written = distribution_of(full, self.written or {})
        if written is not None:
            got, hint = f"{got}, from {show(written)}", hint or _bound_hint(written, expected)
        return RecipeError(problem, where=self.sources.where(full), expected=expected, got=got, hint=hint)

    def _where(self, keys: Keys) -> str:
        return self.sources.where(self.prefix + self._written_keys(keys))

    def _missing(self, keys: Keys) -> RecipeError:
        name, owner = str(keys[-1]), self._class_at(keys[:-1])
        field = None if owner is None else owner.model_fields.get(name)
        expected = None if field is None else field.description
        whole_species = not self.prefix and len(keys) == 3 and keys[0] == "species"
        hint = "write the whole species, or take it from a file: from: NAME" if whole_species else None
        return RecipeError(f"the key {name!r} is missing", where=self._where(keys), expected=expected, hint=hint)

    def _which_form(self, keys: Keys, value: object, discriminator: str) -> RecipeError:
        """A mapping whose key `discriminator` does not name one of the forms that it may have."""
        tags = [str(tag) for arm in _arms(self._annotation_at(keys)) for tag in _tags(arm, discriminator)]
        expected = f"one of {', '.join(tags)}"
        if not isinstance(value, Mapping) or discriminator not in value:
            return RecipeError(f"the key {discriminator!r} is missing", where=self._where(keys), expected=expected)
        tag = value[discriminator]
        hint = did_you_mean(str(tag), tags, cutoff=0.5)
        return self._at((*self._written_keys(keys), discriminator), "bad value", expected, show(tag), hint)

    def _unknown_key(self, keys: Keys) -> RecipeError:
        name, owner = str(keys[-1]), self._class_at(keys[:-1])
        names = [] if owner is None else list(owner.model_fields)
        if not self.prefix and len(keys) == 3 and keys[0] == "species":
            names.append("from")
        expected = f"one of {', '.join(names)}" if names else "no further key"
        hint = did_you_mean(name, names, cutoff=0.5)
        return RecipeError(f"unknown key {name!r}", where=self._where(keys), expected=expected, hint=hint)

    def _tuple_length(self, keys: Keys, kind: str) -> int | None:
        """Length of the tuple that `keys` names, or names an entry of."""
        for arm in _arms(self._annotation_at(keys[:-1] if kind == "missing" else keys)):
            arguments = get_args(arm)
            if get_origin(arm) is tuple and Ellipsis not in arguments:
                return len(arguments)
        return None

    def _written_keys(self, keys: Keys, *, existing: bool = False) -> Keys:
        """`keys` without the forms' names, which the schema library puts between a mapping and its keys.

        `existing`: without the union's arms that it appends, too.
        """
        value: Any = self.data
        written: list[str | int] = []
        named = False
        for key in keys:
            if isinstance(value, Mapping) and key not in value and not named and key in list(value.values()):
                named = True
                continue
            value, named = _entry(value, key), False
            # A filled-in default has no data of its own, but its key is still one of the schema's.
            if existing and value is _ABSENT and self._annotation_at(keys) is None:
                break
            written.append(key)
        return tuple(written)

    def _annotation_at(self, keys: Keys) -> Any:
        """Type of the value at `keys`, or None where the schema has no such key."""
        current: Any = self.model
        value: Any = self.data
        for key in keys:
            found = [step for arm in _arms(current) if (step := _inside(arm, key)) is not None]
            if not found:
                return None
            value = _entry(value, key)
            current = _of_its_part(found[0], None if value is _ABSENT else value)
        return current

    def _class_at(self, keys: Keys) -> type[BaseModel] | None:
        arms = _arms(self._annotation_at(keys))
        return next((arm for arm in arms if isinstance(arm, type) and issubclass(arm, BaseModel)), None)

    def _number_hint(self, keys: Keys, value: object) -> str | None:
        if isinstance(value, str):
            try:
                float(value)
            except ValueError:
                return _unit_hint(keys, value)
            return "remove the quotes"
        if not isinstance(value, Mapping):
            return None
        full = self.prefix + keys
        if is_distribution(value) and any(full[:n] in UNDRAWN for n in range(1, len(full) + 1)):
            return "this key may not be a distribution"
        near = [m for key in value for m in difflib.get_close_matches(str(key), KINDS, n=1)]
        return f"did you mean {{{near[0]}: ...}}?" if near else "a distribution is {uniform: [a, b]}"


def expectation(kind: str, context: Mapping[str, Any], message: str) -> str:
    """What the schema library expected, for people."""
    if kind == "string_pattern_mismatch":
        if context["pattern"] == NAME_PATTERN:
            return "a name of 1 to 64 letters, digits, - or _, not beginning with - or _"
        if context["pattern"] == LABEL_PATTERN:
            return "a name without control characters, and without blanks at its ends"
        return f"text that matches {context['pattern']}"
    if kind in _WITH_CONTEXT:
        return _WITH_CONTEXT[kind](context)
    return _SIMPLE.get(kind, message.removeprefix("Input should be "))


def _bound_hint(written: Mapping[str, Any], expected: str) -> str | None:
    kind = next(iter(written))
    if kind in ("normal", "lognormal"):
        centre, spread = ("mean", "sd") if kind == "normal" else ("median", "sigma")
        return f"truncate the distribution: {{{kind}: {{{centre}: , {spread}: , low: , high: }}}}"
    if "whole number" not in expected:
        return None
    hints = {
        "uniform": "{integers: [a, b]} draws whole numbers",
        "formula": "{formula: 'round(...)'} gives whole numbers",
    }
    return hints.get(kind)


def _unit_hint(keys: Keys, text: str) -> str | None:
    """What to write in place of a number with its unit, where the key's name has one."""
    names = [key for key in keys if isinstance(key, str)]
    unit = next((words for end, words in _UNITS.items() if names and names[-1].endswith(end)), None)
    found = _WITH_UNIT.fullmatch(text.strip())
    if unit is None or found is None:
        return None
    number = found[1] if found[2] in unit.split(", ") else "the number alone"
    return f"{number}: the unit is in the key's name, {unit.split(', ')[0]}"


def _entry(value: Any, key: str | int) -> Any:
    """What a mapping or list has at a key; `_ABSENT`: nothing."""
    if isinstance(value, Mapping):
        return value.get(key, _ABSENT)
    is_index = isinstance(value, list | tuple) and isinstance(key, int) and key < len(value)
    return value[key] if is_index else _ABSENT


def _arms(annotation: Any) -> list[Any]:
    """The types that an annotation admits, without Annotated and None."""
    if get_origin(annotation) is Annotated:
        return _arms(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return [inner for arm in get_args(annotation) for inner in _arms(arm)]
    return [] if annotation in (None, types.NoneType) else [annotation]


def _of_its_part(annotation: Any, value: object) -> Any:
    """The class of the keys of the part that `value` names, where the annotation is of such a section."""
    sections = [arm for arm in _arms(annotation) if isinstance(arm, type) and hasattr(arm, "class_for")]
    try:
        return sections[0].class_for(value) if sections else annotation
    except PydanticCustomError:  # there is no such part, which is an error of its own
        return annotation


def _inside(arm: Any, key: str | int) -> Any:
    origin, arguments = get_origin(arm), get_args(arm)
    if isinstance(arm, type) and issubclass(arm, BaseModel):
        field = arm.model_fields.get(str(key))
        if field is None:
            return arm if any((str(key),) == _tags(arm, name) for name in arm.model_fields) else None
        return field.annotation
    if origin is tuple and isinstance(key, int):
        return arguments[0] if Ellipsis in arguments else arguments[key] if key < len(arguments) else None
    return arguments[-1] if origin in (list, dict) and arguments else None


def _tags(arm: Any, discriminator: str) -> tuple[Any, ...]:
    """What a form's key `discriminator` may say, where it says which form it is."""
    field = arm.model_fields.get(discriminator) if isinstance(arm, type) and issubclass(arm, BaseModel) else None
    return get_args(field.annotation) if field is not None and get_origin(field.annotation) is Literal else ()
