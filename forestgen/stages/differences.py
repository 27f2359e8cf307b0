"""Where two sets of plain values differ, key by key: what a person must look at, and no more."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from forestgen.recipe.messages import show


class Difference(NamedTuple):
    """A key whose values differ; None where one side lacks it."""

    key: str
    before: Any
    now: Any


def differences(before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = "") -> Iterator[Difference]:
    """The keys that differ, as deep as both sides have them: mappings, and lists of one length, are looked into."""
    for key in {**now, **before}:
        yield from _differing(prefix + key, before.get(key), now.get(key))


def _differing(key: str, before: Any, now: Any) -> Iterator[Difference]:
    if before == now:
        return
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        yield from differences(before, now, key + ".")
    elif _are_alike(before, now):
        for index, (one, other) in enumerate(zip(before, now, strict=True)):
            yield from _differing(f"{key}.{index}", one, other)
    else:
        yield Difference(key, before, now)


def _are_alike(before: Any, now: Any) -> bool:
    """Whether both are lists of as many mappings: of plain values, the whole list says more than one entry."""
    lists = isinstance(before, list) and isinstance(now, list) and len(before) == len(now)
    return lists and all(isinstance(one, Mapping) for one in (*before, *now))


def shown(value: Any) -> str:
    """A value as YAML would have it, without keys that say nothing."""
    return "(none)" if value is None else show(_without_nothing(value))


def _without_nothing(value: Any) -> Any:
    """A mapping without the keys that say nothing, such as those of a disturbance that it does not use."""
    if isinstance(value, Mapping):
        return {key: _without_nothing(one) for key, one in value.items() if one is not None}
    return value
