"""Text of the generated pages of docs/reference, which docs/generate.py writes.

The Python API comes from signatures and docstrings, the command line from its help texts.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import re
from collections.abc import Iterator
from typing import Any

import typer

import forestgen as fg
from forestgen.api.catalogue import Entry, SpeciesEntry
from forestgen.api.datasets import Merged, Run
from forestgen.api.diagnosis import Diagnosis
from forestgen.api.points import FittedKernel
from forestgen.api.programs import Words
from forestgen.api.recipes import Validation
from forestgen.atmosphere.clouds.source import CloudRequest, CloudSource
from forestgen.atmosphere.grid import CloudGrid
from forestgen.cli import app
from forestgen.community.capabilities import (
    AskedDensities,
    HasObstacles,
    OwnAir,
    OwnSkeletons,
    PlanChecks,
    SoilWater,
)
from forestgen.community.disturbance import Planting
from forestgen.community.model import CommunityModel, CommunityParameters
from forestgen.community.point_statistics import PointStatistics
from forestgen.community.population import Population, Site, SpeciesEcology, Status
from forestgen.community.static_model import Change, GrowingModel, Placement, StaticModel, StaticParameters
from forestgen.dataset.formats.format import DatasetFormat
from forestgen.dataset.settings import DatasetSettings
from forestgen.instruments.instrument import Instrument, Reading
from forestgen.instruments.stand_table import StandRow, StandTable
from forestgen.labels.labelled import LabelledFrame, PlantViews, VisiblePlants
from forestgen.labels.masks import AmodalMasks, PixelLabels
from forestgen.recipe.cameras import Camera as CameraKeys
from forestgen.runs.start import DryRun
from forestgen.scene.plant_measures import PlantMeasures
from forestgen.scene.projection import DeviceRays, Pixels, Projection, Rays
from forestgen.scene.rigs.rig import Poses, Rig
from forestgen.scene.spec import Camera

_ERRORS = [name for name in fg.__all__ if name.endswith("Error")]
_CLASSES = ("Recipe", "Stand", "Frame", "Dataset", "Plant")
_FUNCTIONS = [name for name in fg.__all__ if name not in (*_ERRORS, *_CLASSES, "__version__")]
_RESULTS = (
    Run,
    Validation,
    DryRun,
    Merged,
    Words,
    FittedKernel,
    PointStatistics,
    Entry,
    SpeciesEntry,
    Diagnosis,
    StandTable,
    StandRow,
)
_STATIC = (StaticModel, GrowingModel, StaticParameters, Placement, Change)
_PROTOCOL = (CommunityModel, CommunityParameters, Site, SpeciesEcology, Population, Status, Planting)
_CAPABILITIES = (PlanChecks, HasObstacles, OwnSkeletons, OwnAir, SoilWater, AskedDensities)
_PROJECTION = (Projection, CameraKeys, Rays, Pixels, DeviceRays, Camera)
_RIG = (Rig, Poses)
_CLOUDS = (CloudSource, CloudRequest, CloudGrid)
_INSTRUMENT = (Instrument, Reading)
_LABELLED = (LabelledFrame, PixelLabels, PlantViews, VisiblePlants, PlantMeasures, AmodalMasks, DatasetSettings)
_WIDTH = 100  # characters of a signature or of a help text
_SECTION = re.compile(r"^([A-Z]\w+)\n-{3,}$", re.MULTILINE)


def api_page() -> str:
    """All names of `forestgen`, and the classes of what they return."""
    text = [
        "# Python API\n",
        "Every name of `import forestgen as fg`. [forestgen from Python](../python.md) introduces them.\n",
        "## Functions\n",
        *(_function(f"fg.{name}", getattr(fg, name)) for name in sorted(_FUNCTIONS)),
        "## Classes\n",
        *(_class(f"fg.{name}", getattr(fg, name)) for name in _CLASSES),
        "## Errors\n",
        *(_class(f"fg.{name}", getattr(fg, name), members=name == "ForestgenError") for name in sorted(_ERRORS)),
        "## Results\n",
        "Classes of returned objects. They are not created by users.\n",
        *(_class(one.__name__, one) for one in _RESULTS),
    ]
    return "\n".join(text).rstrip() + "\n"


def community_models_page() -> str:
    """What the author of a community model needs."""
    text = [
        "# Community models of your own\n",
        "The classes that a community model uses, each with the module to import it from.",
        "[A community model as a plug-in](../tutorials/plugin.md) writes two;",
        "[`fg.register`](api.md#fgregister) adds them.\n",
        "## Base classes\n",
        *_importable(_STATIC),
        "## The protocol of all models\n",
        *_importable(_PROTOCOL),
        "## Capabilities\n",
        "What a model may offer besides, by having the methods.\n",
        *_importable(_CAPABILITIES),
    ]
    return "\n".join(text).rstrip() + "\n"


def dataset_formats_page() -> str:
    """What the author of a data set format needs."""
    text = [
        "# Data set formats of your own\n",
        "A format is an object of a class based on `DatasetFormat`, at the top of a module of its own.",
        '`fg.register("dataset_format", "NAME", "package.module:FORMAT")` or an entry point adds it;',
        "[stems_csv.py](../../examples/plugin/forestgen_plantation/stems_csv.py) is a whole one.\n",
        "## The format\n",
        *_importable((DatasetFormat,)),
        "## What it is given\n",
        *_importable(_LABELLED),
    ]
    return "\n".join(text).rstrip() + "\n"


def light_parts_page() -> str:
    """What the author of a projection, a rig, a cloud source or an instrument needs."""
    text = [
        "# Projections, rigs, clouds and instruments of your own\n",
        "The classes of these parts, each with the module to import it from. A part is one object of a class based on",
        "the first of a section, at the top of a module; `fg.register` or an entry point adds it. Methods that are",
        "required must be given; the others have a default.",
        "[examples/plugin](../../examples/plugin) has one of each.\n",
        "## Projections\n",
        "Cameras look along z; x is right, y is down. `x` and `y` of `rays` are pixels from the image's middle, and so",
        "are those that `project` returns. A key of the projection's own reaches both as `camera.numbers`, which the",
        "keys' class fills in `own_numbers`; `camera.hfov_deg` is what it returns as `field_of_view_deg`.\n",
        *_importable(_PROJECTION),
        "## Rigs\n",
        *_importable(_RIG),
        "## Cloud sources\n",
        *_importable(_CLOUDS),
        "## Instruments\n",
        *_importable(_INSTRUMENT),
    ]
    return "\n".join(text).rstrip() + "\n"


def _importable(classes: tuple[type, ...]) -> Iterator[str]:
    return (_class(f"{one.__module__}.{one.__name__}", one, title=one.__name__) for one in classes)


def command_line_page() -> str:
    """The help text of every command."""
    group: Any = typer.main.get_command(app)
    text = [
        "# Command line\n",
        "The help texts of all commands. `forestgen COMMAND --help` prints them.",
        "[Exit codes](../guide.md#exit-codes) are in the guide.\n",
        _help("forestgen", group),
    ]
    for name, command in group.commands.items():
        text += [f"## {name}\n", _help(f"forestgen {name}", command)]
    return "\n".join(text).rstrip() + "\n"


def _help(name: str, command: Any) -> str:
    context = command.context_class(command, info_name=name, terminal_width=_WIDTH, max_content_width=_WIDTH)
    return f"```text\n{command.get_help(context).rstrip()}\n```\n"


def _function(name: str, function: Any, level: str = "###") -> str:
    required = "*Required.* " if "NotImplementedError" in function.__code__.co_names else ""
    signature = _signature(name.removeprefix("fg."), function)
    return f"{level} {name}\n\n{signature}\n{required}{_documentation(function)}\n"


def _class(name: str, one: type, *, members: bool = True, title: str | None = None) -> str:
    """A class: its signature unless others make its objects, its documentation, its public members."""
    base = one.__mro__[1]
    bases = f"({base.__name__})" if base.__module__.startswith("forestgen.core.errors") else ""
    text = [f"### {title or name}\n"]
    if bases or title:
        text.append(f"```text\nclass {name}{bases}\n```\n")
    if inspect.getdoc(one) == "See the module.":
        text.append(_prose(inspect.getdoc(inspect.getmodule(one)) or ""))
    elif not (inspect.getdoc(one) or "").startswith(f"{one.__name__}("):  # what dataclasses write by themselves
        text.append(_documentation(one))
    if members:
        attributes, methods = _members(one)
        if attributes:
            text += ["| attribute | type | |", "|---|---|---|", *attributes, ""]
        text += [_function(f"{one.__name__}.{key}", value, "####") for key, value in methods]
    return "\n".join(text)


def _members(one: type) -> tuple[list[str], list[tuple[str, Any]]]:
    """Rows of a table of fields and properties, and the public methods, in the order of the source."""
    rows, methods = [], []
    comments = _comments(one)
    if issubclass(one, enum.Enum):
        return [f"| `{member.name}` | `{member.value}` | |" for member in one], []
    kinds = {field.name: field.type for field in dataclasses.fields(one)} if dataclasses.is_dataclass(one) else {}
    names = kinds or ({} if hasattr(one, "model_fields") else inspect.get_annotations(one))
    for name, kind in names.items():
        rows.append(f"| `{name}` | {_cell_of_type(kind)} | {comments.get(name, '')} |")
    for name, field in getattr(one, "model_fields", {}).items():
        kind = inspect.get_annotations(one).get(name) or inspect.get_annotations(one.__mro__[1]).get(name, "")
        rows.append(f"| `{name}` | {_cell_of_type(kind)} | {field.description or ''} |")
    own = [base for base in one.__mro__ if base.__module__.startswith("forestgen.api.")] or [one]
    for name, value in (item for base in own for item in vars(base).items()):
        if name.startswith("_") or name in names or name.startswith("model_"):
            continue
        getter = getattr(value, "fget", None) or getattr(value, "func", None)
        function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
        if getter is not None:
            kind = getter.__annotations__.get("return", "")
            rows.append(f"| `{name}` | {_cell_of_type(kind)} | {_first_paragraph(getter)} |")
        elif inspect.isfunction(function):
            methods.append((name, function))
    return rows, methods


def _comments(one: type) -> dict[str, str]:
    """Name of a field -> the comment behind it."""
    try:
        source = inspect.getsource(one)
    except OSError:
        return {}
    found = re.findall(r"^    (\w+): .*?  # (.*)$", source, re.MULTILINE)
    return {name: text.replace("|", "\\|") for name, text in found if not text.startswith(("noqa", "type:"))}


def _cell_of_type(kind: Any) -> str:
    text = kind if isinstance(kind, str) else getattr(kind, "__name__", str(kind))
    return f"`{text}`".replace("|", "\\|") if text else ""


def _first_paragraph(function: Any) -> str:
    return (inspect.getdoc(function) or "").split("\n\n")[0].replace("\n", " ").replace("|", "\\|")


def _signature(name: str, function: Any) -> str:
    """A block of text; a parameter a line if it is long."""
    found = inspect.signature(function)
    owner = name.rpartition(".")[0] or None  # a method's class, which its first parameter may be annotated with
    given = [
        one for one in found.parameters.values() if one.name != "self" and owner not in str(one.annotation).split(" | ")
    ]
    parameters = list(_with_stars(given))
    answer = f" -> {found.return_annotation}" if found.return_annotation is not inspect.Signature.empty else ""
    short = f"({', '.join(parameters)}){answer}"
    if len(name + short) > _WIDTH:
        short = "(\n" + "".join(f"    {one},\n" for one in parameters) + f"){answer}"
    return f"```text\n{name}{short}\n```\n"


def _with_stars(parameters: list[inspect.Parameter]) -> Iterator[str]:
    keyword = False
    for one in parameters:
        if one.kind is inspect.Parameter.KEYWORD_ONLY and not keyword:
            keyword = True
            yield "*"
        default = "" if one.default is inspect.Parameter.empty else f" = {one.default!r}"
        yield f"{one.name}: {one.annotation}{default}" if one.annotation is not one.empty else f"{one.name}{default}"


def _documentation(one: Any) -> str:
    """A docstring: its text, and its sections of parameters and errors as lists."""
    parts = _SECTION.split(inspect.getdoc(one) or "")
    text = [_prose(parts[0])]
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        text.append(f"**{title}**\n")
        text.append(_entries(body) if title in ("Parameters", "Raises") else _prose(body))
    return "\n".join(text)


def _entries(body: str) -> str:
    """Lines ``name : text``, which indented lines continue, as a list."""
    lines: list[str] = []
    for line in body.strip("\n").splitlines():
        if line.startswith("    ") and lines:
            lines[-1] += " " + line.strip()
        elif line.strip():
            lines.append(line.strip())
    items = []
    for line in lines:
        names, colon, text = line.partition(" : ")
        names = ", ".join(f"`{name.strip()}`" for name in names.split(","))
        items.append(f"- {names}: {text}" if colon else f"- {names}")
    return "\n".join(items) + "\n"


def _prose(text: str) -> str:
    """Text as it is; blocks behind ``::`` and examples as fenced blocks."""
    out: list[str] = []
    for block in re.split(r"\n\s*\n", text.strip()):
        lines = block.splitlines()
        if block.startswith(("    ", ">>>")) or (lines and lines[0].startswith("===")):
            out.append("\n".join(["```text", *(line.removeprefix("    ") for line in lines), "```"]))
        else:
            out.append(block[:-1] if block.endswith("::") else block)
    return "\n\n".join(out) + "\n"
