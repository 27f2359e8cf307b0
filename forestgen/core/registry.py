"""Names of interchangeable parts, each a dotted path that is imported when the part is used.

Other packages add parts by `Registry.register`, or by entry points of groups such as ``forestgen.community_model``,
which are read only when parts are listed or a name is unknown. Worker processes get the parts in use by
`registrations`; the hash of code (`forestgen.core.cache`) covers them too.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import re
import sys
import traceback
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_type_hints

from forestgen.core.arguments import shown
from forestgen.core.errors import RecipeError

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_PLACE = re.compile(r"([^\W\d]\w*(?:\.[^\W\d]\w*)*):([^\W\d]\w*)")
_registered: list[Registration] = []
_registries: dict[str, Registry] = {}  # by kind


@dataclass(frozen=True)
class Registration:
    """A part of another package."""

    kind: str  # of the registry
    name: str
    path: str  # module:attribute
    description: str


def registrations() -> tuple[Registration, ...]:
    """All parts of other packages that this process registered or used."""
    return tuple(_registered)


def explained_bug(error: BaseException) -> str:
    """Text about an error that nobody foresaw: whose it is, and its place in the code.

    It is another package's where the innermost of its frames that is of a part's package or of forestgen is the former.
    """
    owners = {one.path.partition(":")[0].partition(".")[0] for one in _registered}
    owner, place = "forestgen", ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        package = str(frame.f_globals.get("__name__")).partition(".")[0]
        if package == "forestgen" or package in owners:
            owner = package
        place = f" ({Path(frame.f_code.co_filename).name}:{line})"
    whose = "a bug in forestgen" if owner == "forestgen" else f"an error in {owner}, which is no part of forestgen"
    return f"{whose}: {type(error).__name__}: {error}{place}"


def register_again(parts: Iterable[Registration]) -> None:
    """Register in a worker process what was registered in the process that started it."""
    for one in parts:
        if one.kind in _registries:
            _registries[one.kind].register(one.name, one.path, one.description)
        elif one not in _registered:
            _registered.append(one)  # its registry takes it when it is made


class Registry:
    """Maps an id to an object named ``module:attribute`` that is imported when it is first asked for.

    Parameters
    ----------
    kind : what the entries are, for messages, such as "community model".
    entries : id -> (dotted path, one line of description).
    contract : ``module:class`` whose attributes each part has; the annotation of its `Parameters`, if it has some,
        names their base class.
    """

    def __init__(self, kind: str, entries: Mapping[str, tuple[str, str]], *, contract: str) -> None:
        self.kind = kind
        self._contract = contract
        self._group = f"forestgen.{kind.replace(' ', '_')}"  # of entry points
        self._shipped = frozenset(entries)
        self._entries = dict(entries)
        self._entries |= {one.name: (one.path, one.description) for one in _registered if one.kind == kind}
        _registries[kind] = self

    def __iter__(self) -> Iterator[str]:
        """Ids in the order in which they were entered, then those of entry points."""
        return iter((*self._entries, *self._installed()))

    def __contains__(self, name: object) -> bool:
        return name in self._entries or name in self._installed()

    def ids(self) -> list[str]:
        return sorted(self)

    def describe(self, name: str) -> str:
        return self._entry(name)[1]

    def register(self, name: str, path: str, description: str) -> None:
        """Add a part: the name that recipes use, ``module:attribute``, and one line of description.

        Raises `RecipeError` for a name that is taken or malformed.
        """
        if not _NAME.fullmatch(name):
            expected = "letters, digits and underscores, a letter first"
            raise RecipeError(f"no name for a {self.kind}", parameter="name", expected=expected, got=repr(name))
        if self._entries.setdefault(name, (path, description))[0] != path or name in self._shipped:
            problem = f"there is a {self.kind} of this name already"
            raise RecipeError(problem, parameter="name", expected="another name", got=repr(name))
        entry = Registration(self.kind, name, *self._entries[name])
        if entry not in _registered:
            _registered.append(entry)

    def check(self, name: str, *, where: str | None = None, parameter: str | None = None) -> None:
        """Raise `RecipeError` that lists the valid names for an unknown one; imports no part."""
        if name not in self:
            near = difflib.get_close_matches(name, known := self.ids(), n=1)
            problem, expected = f"unknown {self.kind}", "one of " + ", ".join(known)
            entry = f"a part of your own needs `fg.register` in this process, or an entry point {self._group!r}"
            hint = f"did you mean {near[0]!r}?" if near else entry
            raise RecipeError(problem, where=where, parameter=parameter, expected=expected, got=repr(name), hint=hint)

    def load(self, name: str, *, where: str | None = None) -> Any:
        """The part to use, which counts among `registrations` if it is another package's.

        Raises `RecipeError` for an unknown name, and for another package's part that cannot be imported or lacks what
        its kind must have.
        """
        part = self.part(name, where=where)
        if name not in self._entries:
            self.register(name, *self._entry(name))
        return part

    def use(self, name: str, *, where: str | None = None) -> None:
        """Before work begins: check another package's part by `load`; shipped parts are not imported."""
        if name not in self._shipped:
            self.load(name, where=where)

    def load_all(self, names: Collection[str]) -> list[Any]:
        """The parts of several names, in the registry's order."""
        found = {name: self.load(name) for name in names}
        return [found[name] for name in self._entries if name in found]

    def part(self, name: str, *, where: str | None = None) -> Any:
        """As `load`, but the part does not count as used."""
        self.check(name, where=where)
        path, description = self._entry(name)
        if name in self._shipped:
            module, _, attribute = path.partition(":")
            return getattr(importlib.import_module(module), attribute)
        try:
            found = part_at(path)
            self.check_part(name, found)
        except RecipeError as error:
            problem = f"{self.kind} {name}{f' ({description})' if description else ''}: {error.problem}"
            raise RecipeError(problem, where=where, expected=error.expected, got=error.got, hint=error.hint) from error
        return found

    def parts(self) -> Iterator[tuple[str, Any]]:
        """Each id and its part, without other packages' parts that are broken; none counts as used."""
        for name in self:
            try:
                found = self.part(name)
            except RecipeError:
                continue
            yield name, found

    def check_part(self, name: str, part: object) -> None:
        """Raise `RecipeError` for an object that lacks what parts of this kind have."""
        contract = part_at(self._contract)
        if isinstance(part, type):
            hint = f"an object of it: MODEL = {part.__name__}(), at the top of its module"
            raise RecipeError("this is a class", parameter="part", expected="an object", got=shown(part), hint=hint)
        own = {**getattr(contract, "__annotations__", {}), **vars(contract)}
        names = sorted(one for one in own if not one.startswith("_"))
        missing = [one for one in names if not hasattr(part, one) or _is_stub(part, contract, one)]
        if missing:
            problem, expected = f"this is no {self.kind}: it has no {', '.join(missing)}", f"what {self._contract} has"
            raise RecipeError(problem, parameter="part", expected=expected, got=shown(part))
        if "name" in own and (other := getattr(part, "name")) != name:  # noqa: B009 - its type is not known
            raise RecipeError("it has another name", parameter="part", expected=repr(name), got=shown(other))
        if "Parameters" in own:
            (base,) = get_args(get_type_hints(contract)["Parameters"])
            base = getattr(base, "__bound__", base)  # of a type variable
            given = getattr(part, "Parameters")  # noqa: B009
            if not (isinstance(given, type) and issubclass(given, base)):
                expected = f"a class based on {base.__module__}.{base.__name__}"
                problem = "its Parameters are of another kind"
                raise RecipeError(problem, parameter="part", expected=expected, got=shown(given))

    def _entry(self, name: str) -> tuple[str, str]:
        return self._entries.get(name) or self._installed()[name]

    def _installed(self) -> dict[str, tuple[str, str]]:
        """Entries of the entry points of installed packages whose names are not taken."""
        found: dict[str, tuple[str, str]] = {}
        for name, path, package in _entry_points(self._group, tuple(sys.path)):
            if name in found:  # no path: using it is an error
                found[name] = ("", f"{found[name][1]}, and of {package}")
            elif _NAME.fullmatch(name) and name not in self._entries:
                found[name] = (path, f"of the package {package}")
        return found


@cache
def _entry_points(group: str, paths: tuple[str, ...]) -> list[tuple[str, str, str]]:
    """(name, place, package and version) of all entry points of a group, sorted; `paths` are where packages lie."""
    from importlib.metadata import entry_points

    points = entry_points(group=group)
    return sorted((one.name, one.value, f"{one.dist.name} {one.dist.version}") for one in points if one.dist)


def _is_stub(part: object, contract: type, name: str) -> bool:
    """Whether a part inherits a method that parts must have of their own: a protocol's, or one that is not written."""
    stub = vars(contract).get(name)
    if not inspect.isfunction(stub):
        return False
    is_stub = getattr(contract, "_is_protocol", False) or "NotImplementedError" in stub.__code__.co_names
    return is_stub and getattr(type(part), name, None) is stub


def part_at(path: str) -> Any:
    """The object at ``package.module:NAME``. Raises `RecipeError` where it cannot be found or imported."""
    match = _PLACE.fullmatch(path)
    if match is None:
        raise _error("this is no place of a part", path)
    module, name = match.groups()
    try:
        found = importlib.import_module(module)
    except Exception as error:  # whatever another package's code raises
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing is not None and f"{module}.".startswith(f"{missing}."):
            hint = "install its package, or add its folder to sys.path and, for worker processes, to PYTHONPATH"
            raise _error(f"there is no module {module}", path, hint) from error
        said = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        problem, expected = f"the module {module} cannot be imported", f"{path!r:.200}"
        raise RecipeError(problem, parameter="part", expected=expected, got=said) from error
    if not hasattr(found, name):
        raise _error(f"the module {module} has no {name}", path)
    return getattr(found, name)


def _error(problem: str, path: str, hint: str | None = None) -> RecipeError:
    return RecipeError(problem, parameter="part", expected="'package.module:NAME'", got=shown(path), hint=hint)
