"""YAML text to plain data with the place of each key, and back; what is wrong with a text is an error for people.

A key was written in a line of a file, or in an override, `` `set='key=value'` ``.
"""

from __future__ import annotations

import io
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer, MaxDepthExceededError
from ruamel.yaml.constructor import ConstructorError
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.representer import SafeRepresenter

from forestgen.core.arguments import read_text
from forestgen.core.errors import ForestgenError, RecipeError

Keys = tuple[str | int, ...]
MAX_BYTES = 1_000_000  # more than any hand writes; ruamel reads some 20 kB a second
MAX_DEPTH = 40
LARGEST = 1e100
MAX_NODES = 100_000  # keys and values, aliases aside
MAX_ALIAS_NODES = 100_000  # values that aliases (*name) may add: a few lines of nested aliases can mean billions
_LONG = 100_000  # characters of text that is not kept
_TAG = "tag:yaml.org,2002:"
_NUMBERS_AND_FLAGS = {_TAG + kind for kind in ("int", "float", "bool", "null")}
_TEXTS = {_TAG + "str", _TAG + "timestamp", "!"}
_KEYS = _TEXTS | {_TAG + "int", _TAG + "float"}  # as they are written: a species' code may be 010
_SCALARS, _CONTAINERS = _NUMBERS_AND_FLAGS | _TEXTS, {_TAG + "map", _TAG + "seq", "!"}


@dataclass(frozen=True)
class Place:
    """A file and line (from 1), or an override if `line` is None."""

    origin: str
    line: int | None = None

    def __str__(self) -> str:
        return self.origin if self.line is None else f"{self.origin}:{self.line}"


def dotted(keys: Keys) -> str:
    """``("cameras", 0, "size_px")`` as ``cameras.0.size_px``, the way overrides write it."""
    return ".".join(str(key) for key in keys)


@dataclass
class SourceMap:
    """Place of every key path. A path that was never written lies where its nearest ancestor lies."""

    places: dict[Keys, Place] = field(default_factory=dict)

    def place(self, keys: Keys) -> Place:
        """Place of the longest written beginning of `keys`."""
        for n in range(len(keys), 0, -1):
            if keys[:n] in self.places:
                return self.places[keys[:n]]
        return self.places.get((), Place("recipe"))

    def where(self, keys: Keys) -> str:
        """``file:line: a.b.c``, or only the place for the recipe as a whole."""
        place = self.place(keys)
        return f"{place}: {dotted(keys)}" if keys else str(place)

    def drop(self, prefix: Keys) -> None:
        """Forget `prefix` and all below it."""
        n = len(prefix)
        for keys in [keys for keys in self.places if keys[:n] == prefix]:
            del self.places[keys]

    def take(self, other: SourceMap, source: Keys, target: Keys) -> None:
        """Copy the places of `other` at and below `source` to `target`."""
        n = len(source)
        for keys, place in list(other.places.items()):
            if keys[:n] == source:
                self.places[target + keys[n:]] = place


def copied(value: Any) -> Any:
    """A copy of plain data, mappings and lists and what is in them, several times as fast as `copy.deepcopy`."""
    if type(value) is dict:
        return {key: copied(item) for key, item in value.items()}
    if type(value) is list:
        return [copied(item) for item in value]
    return value


def read_yaml(path: Path, *, error: type[ForestgenError] = RecipeError) -> tuple[dict[str, Any], SourceMap]:
    """The mapping in a YAML file and where its keys are.

    Raises `AssetError` where the file is missing or unreadable, and `error` where its text is not a YAML mapping.
    """
    return mapping_of(read_text(path, "a YAML file", most_bytes=MAX_BYTES), str(path), error=error)


def mapping_of(
    text: str, origin: str, *, error: type[ForestgenError] = RecipeError
) -> tuple[dict[str, Any], SourceMap]:
    """The mapping in a YAML text and where its keys are; see `read_yaml`. `origin` names the text in messages."""
    if len(text) > MAX_BYTES:
        raise error("the text is too large", where=origin, expected=f"at most {MAX_BYTES // 10**6} MB", got="more")
    data, sources = parse_yaml(text, origin, error=error)
    if data is None:
        raise error("the text is empty", where=origin, expected="a mapping of keys to values", got="no content")
    if not isinstance(data, dict):
        got = "a list" if isinstance(data, list) else f"{str(data)[:60]!r}"
        raise error("not a mapping", where=f"{origin}:1", expected="lines such as 'seed: 7'", got=got)
    return data, sources


def parse_yaml(
    text: str, origin: str, *, error: type[ForestgenError] = RecipeError, lines: bool = True
) -> tuple[Any, SourceMap]:
    """Plain data of YAML text; `origin` names the text in messages. No content is None.

    Text that was parsed before is not parsed again: recipes name the same few species, whose files take 0.1 s each.
    """
    parse = _parse if len(text) < _LONG else _parse.__wrapped__
    data, sources = parse(text, origin, error, lines)  # type: ignore[arg-type]  # a class is hashable
    return copied(data), SourceMap(dict(sources.places))


@lru_cache(maxsize=64)
def _parse(text: str, origin: str, error: type[ForestgenError], lines: bool) -> tuple[Any, SourceMap]:
    reader = _Reader(origin, error, lines)
    try:
        node = reader.yaml.compose(text)
        data = None if node is None else reader.value(node, (), 0)
    except MaxDepthExceededError as cause:
        raise reader.too_deep(origin) from cause
    except _TooManyNodesError as cause:
        expected = f"at most {MAX_NODES:,} keys and values; large maps and tables as files of their own"
        raise error("the text has too many values", where=origin, expected=expected, got="more") from cause
    except MarkedYAMLError as cause:
        line = None if cause.problem_mark is None else cause.problem_mark.line + 1
        where = f"{origin}:{line}" if line and lines else origin
        detail = " ".join(str(part) for part in (cause.context, cause.problem) if part)
        raise error("not valid YAML", where=where, got=detail, hint="check indentation, brackets, quotes") from cause
    except (YAMLError, ValueError, OverflowError) as cause:
        detail = str(cause).splitlines()[0][:200]
        raise error("not valid YAML", where=origin, expected="readable text", got=detail) from cause
    except RecursionError as cause:
        raise reader.too_deep(origin) from cause
    return data, reader.sources


def _is_unseen(character: str) -> bool:
    """Whether a character would steer a terminal, or turn round what is read, and is no space between words."""
    if character in "\t\n\r\f\u200c\u200d\xad\ufeff":  # the latter join and part letters
        return False
    return unicodedata.category(character) in ("Cc", "Cf", "Cs")


class _TooManyNodesError(Exception):
    """More keys and values than `MAX_NODES`."""


class _Composer(Composer):
    """Stops where a text has too many nodes, before it has read them all."""

    _nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise _TooManyNodesError
        return super().compose_node(parent, index)


class _Reader:
    """Walks YAML nodes once: values, lines, and limits."""

    def __init__(self, origin: str, error: type[ForestgenError], lines: bool) -> None:
        self.yaml = YAML(typ="safe", pure=True)
        self.yaml.Composer = _Composer
        self.yaml.max_depth = 2 * MAX_DEPTH  # counts in another way than ours; far deeper text takes minutes to read
        self.sources = SourceMap({(): Place(origin, 1 if lines else None)})
        self._origin, self._error, self._lines = origin, error, lines
        self._seen: set[int] = set()
        self._aliased = 0

    def _at(self, node: Node) -> Place:
        return Place(self._origin, node.start_mark.line + 1 if self._lines else None)

    def too_deep(self, where: str) -> ForestgenError:
        return self._error("nested too deeply", where=where, expected=f"at most {MAX_DEPTH} levels")

    def value(self, node: Node, keys: Keys, depth: int) -> Any:
        if depth > MAX_DEPTH:
            raise self.too_deep(str(self._at(node)))
        self._count_aliases(node)
        if node.tag not in (_SCALARS if isinstance(node, ScalarNode) else _CONTAINERS):
            expected = "numbers, texts, true, false, null, lists and mappings"
            got = str(node.tag).replace(_TAG, "!!")[:60]
            problem, where = "this YAML tag is not allowed", self._where(node, keys)
            raise self._error(problem, where=where, expected=expected, got=got)
        if isinstance(node, MappingNode):
            return self._mapping(node, keys, depth)
        if isinstance(node, SequenceNode):
            for i, item in enumerate(node.value):
                self.sources.places[(*keys, i)] = self._at(item)
            return [self.value(item, (*keys, i), depth + 1) for i, item in enumerate(node.value)]
        assert isinstance(node, ScalarNode)  # there are no others
        return self._scalar(node, keys)

    def _count_aliases(self, node: Node) -> None:
        # A node met again is an alias; every value below it is met again too.
        self._aliased += id(node) in self._seen
        self._seen.add(id(node))
        if self._aliased > MAX_ALIAS_NODES:
            problem, expected = "too many values by aliases (*name)", f"at most {MAX_ALIAS_NODES} aliased values"
            raise self._error(problem, where=str(self._at(node)), expected=expected)

    def _mapping(self, node: MappingNode, keys: Keys, depth: int) -> dict[str, Any]:
        result: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        first: dict[str, Place] = {}
        for key_node, value_node in node.value:
            if key_node.tag == _TAG + "merge":
                merged = {**self._merge(value_node, keys, depth), **merged}
                continue
            key = self._key(key_node)
            if key in first:
                where, got = str(self._at(key_node)), f"{key!r} here and at {first[key]}"
                raise self._error(f"the key {key!r} stands twice", where=where, expected="each key once", got=got)
            first[key] = self._at(key_node)
            if key in merged:
                self.sources.drop((*keys, key))
            self.sources.places[(*keys, key)] = first[key]
            result[key] = self.value(value_node, (*keys, key), depth + 1)
        return {**merged, **result}

    def _merge(self, node: Node, keys: Keys, depth: int) -> dict[str, Any]:
        """``<<: *name`` or a list of such; the earlier wins."""
        parts = node.value if isinstance(node, SequenceNode) else [node]
        merged: dict[str, Any] = {}
        for part in parts:
            if not isinstance(part, MappingNode):
                raise self._error("'<<' takes a mapping", where=str(self._at(node)), expected="<<: *name")
            merged = {**self.value(part, keys, depth + 1), **merged}
        return merged

    def _key(self, node: Node) -> str:
        if isinstance(node, ScalarNode) and node.tag in _KEYS:
            return self._text(node, ())
        got, where = str(node.value) if isinstance(node, ScalarNode) else "a list or mapping", str(self._at(node))
        raise self._error("a key must be text", where=where, expected="a name", got=got[:60], hint="quote it")

    def _text(self, node: ScalarNode, keys: Keys) -> str:
        text = str(node.value)
        if not text.isprintable() and any(_is_unseen(one) for one in text):
            got, expected = ascii(text)[:60], "characters that are seen, and no half of one"
            raise self._error("not a text", where=self._where(node, keys), expected=expected, got=got)
        return text

    def _scalar(self, node: ScalarNode, keys: Keys) -> Any:
        if node.tag in _TEXTS:
            return self._text(node, keys)
        try:
            value = self.yaml.constructor.construct_object(node)
        except (ValueError, OverflowError, ConstructorError) as cause:
            got = str(node.value)[:60]
            raise self._error("not a number", where=self._where(node, keys), got=got) from cause
        if isinstance(value, int | float) and not abs(value) <= LARGEST:
            got, expected = str(node.value)[:60], "a finite number of reasonable size"
            raise self._error("bad value", where=self._where(node, keys), expected=expected, got=got)
        return value

    def _where(self, node: Node, keys: Keys) -> str:
        return f"{self._at(node)}: {dotted(keys)}" if keys else str(self._at(node))


class _Representer(SafeRepresenter):
    """Writes texts of several lines, such as programs, line by line."""

    def represent_text(self, text: str) -> Any:
        return self.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Representer.add_representer(str, _Representer.represent_text)


def yaml_text(data: Mapping[str, Any]) -> str:
    """Plain data as YAML text, the same bytes for the same data."""
    yaml = YAML(typ="safe", pure=True)
    yaml.Representer = _Representer
    yaml.default_flow_style = None  # lists of numbers on one line
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.allow_unicode = True
    yaml.width = 120
    yaml.representer.ignore_aliases = lambda *_: True
    text = io.StringIO()
    yaml.dump(data, text)
    return text.getvalue()
