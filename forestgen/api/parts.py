"""Parts of other packages: found at their place, and checked when they are registered."""

from __future__ import annotations

import importlib
import importlib.util
import re

from pydantic import BaseModel

from forestgen.community.environments.contract import Environment
from forestgen.community.model import CommunityModel, CommunityParameters
from forestgen.core.arguments import shown
from forestgen.core.errors import RecipeError
from forestgen.dataset.formats.format import DatasetFormat
from forestgen.geometry.export import MeshExporter
from forestgen.plants.parameters import Generator, PlantParameters

_PLACE = re.compile(r"([^\W\d]\w*(?:\.[^\W\d]\w*)*):([^\W\d]\w*)")
#: Of each kind its contract and the class of its `Parameters`, if it has some.
_CONTRACTS: dict[str, tuple[type, type[BaseModel] | None]] = {
    "community_model": (CommunityModel, CommunityParameters),
    "environment": (Environment, BaseModel),
    "plant_generator": (Generator, PlantParameters),
    "dataset_format": (DatasetFormat, None),
    "mesh_exporter": (MeshExporter, None),
}


def part_at(path: str) -> object:
    """The object at ``package.module:NAME``.

    Raises
    ------
    RecipeError : this is no such place, there is no such module, it has no such name, or it cannot be imported.
    """
    match = _PLACE.fullmatch(path)
    if match is None:
        raise _error("this is no place of a part", path)
    module, name = match.groups()
    try:
        there = importlib.util.find_spec(module) is not None
    except ModuleNotFoundError as error:
        if error.name is None or not module.startswith(error.name):
            raise _failed(path, module, error) from error
        there = False
    except Exception as error:  # of a package above it, which is a stranger's code
        raise _failed(path, module, error) from error
    if not there:
        hint = "install its package, or add its folder to sys.path and, for worker processes, to PYTHONPATH"
        raise _error(f"there is no module {module}", path, hint)
    try:
        found = importlib.import_module(module)
    except Exception as error:
        raise _failed(path, module, error) from error
    if not hasattr(found, name):
        raise _error(f"the module {module} has no {name}", path)
    return getattr(found, name)


def _error(problem: str, path: str, hint: str | None = None) -> RecipeError:
    return RecipeError(problem, where="part", expected="'package.module:NAME'", got=shown(path), hint=hint)


def _failed(path: str, module: str, error: Exception) -> RecipeError:
    said = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return RecipeError(f"the module {module} cannot be imported", where="part", expected=f"{path!r:.200}", got=said)


def check_part(kind: str, part: object) -> None:
    """Raise `RecipeError` for an object that lacks what parts of its kind have."""
    contract, parameters = _CONTRACTS[kind]
    if isinstance(part, type):
        hint = f"an object of it: MODEL = {part.__name__}(), at the top of its module"
        raise RecipeError("this is a class", where="part", expected="an object", got=shown(part), hint=hint)
    own = {**getattr(contract, "__annotations__", {}), **vars(contract)}
    names = sorted(name for name in own if not name.startswith("_"))
    missing = [name for name in names if not hasattr(part, name)]
    if kind == "plant_generator" and hasattr(part, "build"):  # what is built is no plant, and does not grow
        missing = [name for name in missing if name != "grow"]
    wanted = f"{contract.__module__}.{contract.__name__}"
    if missing:
        problem = f"this is no {kind.replace('_', ' ')}: it has no {', '.join(missing)}"
        raise RecipeError(problem, where="part", expected=f"what {wanted} asks for", got=shown(part))
    if parameters is None:
        return
    given = getattr(part, "Parameters")  # noqa: B009 - its type is not known
    if not (isinstance(given, type) and issubclass(given, parameters)):
        expected = f"a class based on {parameters.__module__}.{parameters.__name__}"
        raise RecipeError("its Parameters are none", where="part", expected=expected, got=shown(given))
