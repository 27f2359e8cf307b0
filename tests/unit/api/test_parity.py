"""The command line does nothing that Python cannot: every command and option has its function and parameter."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import typer

import forestgen as fg
from forestgen.api.plants import grow_files
from forestgen.cli import app

# The functions that a command's options are parameters of.
FUNCTIONS: dict[str, tuple[Callable[..., Any], ...]] = {
    "render": (fg.load, fg.Recipe.render, fg.Recipe.estimate),
    "batch": (fg.load, fg.Recipe.batch, fg.Recipe.estimate),
    "verify": (fg.Dataset, fg.Dataset.verify),
    "report": (fg.Dataset, fg.Dataset.report),
    "pack": (fg.Dataset, fg.Dataset.pack),
    "merge": (fg.merge,),
    "simulate": (fg.load, fg.Recipe.simulate),
    "plant": (grow_files, fg.plant, fg.Plant.export, fg.Plant.picture, fg.Plant.sway),
    "validate": (fg.load, fg.Recipe.validate),
    "models": (fg.models,),
    "schema": (fg.schema,),
    "stats": (fg.stats,),
    "fit-kernel": (fg.fit_kernel,),
    "lsystem": (fg.derive,),
    "light": (fg.load, fg.Recipe.light),
    "weather": (fg.load, fg.Recipe.weather),
    "calibrate": (fg.load, fg.Recipe.calibrate),
    "measure": (fg.load, fg.Recipe.measure),
    "stand": (fg.load, fg.Recipe.stand),
    "doctor": (fg.doctor,),
}
# Options whose parameter has another name: one value of many, or a flag's opposite.
OTHER_NAMES = {
    "--map-step": "map_steps",
    "--graph": "graphs",
    "--normal": "normals",
    "--key": "keys",
    "--split": "splits",
    "--resource": "resources",
    "--no-hashes": "hashes",
    "--no-founders": "founders",
}
OF_PRINTING = {"--json", "--quiet", "--verbose", "--help"}  # what is printed; in Python the values themselves
# What another function or another form of the same call does.
ELSEWHERE = {
    ("render", "--dry-run"): fg.Recipe.estimate,
    ("batch", "--dry-run"): fg.Recipe.estimate,
    ("render", "--first"): fg.load,  # set={"first_image": N}
    ("batch", "--first"): fg.load,
    ("plant", "--list"): fg.species,
    ("lsystem", "--format"): fg.derive,  # Words.text, as_dict() and modules
    ("calibrate", "--normal"): fg.Recipe.calibrate,
}


def commands() -> dict[str, Any]:
    group: Any = typer.main.get_command(app)
    return dict(group.commands)


def options(command: Any) -> Iterator[str]:
    for parameter in command.params:
        if parameter.param_type_name == "option":
            yield next(name for name in parameter.opts if name.startswith("--"))


def test_every_command_has_its_functions() -> None:
    assert set(commands()) - {"completion"} == set(FUNCTIONS)


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_every_option_is_a_parameter(name: str) -> None:
    parameters = {one for function in FUNCTIONS[name] for one in inspect.signature(function).parameters}
    for option in options(commands()[name]):
        if option in OF_PRINTING or (name, option) in ELSEWHERE:
            continue
        parameter = OTHER_NAMES.get(option, option.removeprefix("--").replace("-", "_"))
        assert parameter in parameters, f"{name} {option}"


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_an_option_has_one_name_everywhere(name: str) -> None:
    """Of the names of one thing, the one that all commands have."""
    found = set(options(commands()[name]))
    assert found.isdisjoint({"--output", "--images", "--jobs", "--cores", "--processes", "--force", "--verbosity"})
    for parameter in commands()[name].params:
        if "--out" in parameter.opts:
            assert "-o" in parameter.opts


@pytest.mark.parametrize("name", ["validate", "doctor", "models", "stats", "stand", "verify"])
def test_what_is_looked_up_can_be_json(name: str) -> None:
    assert "--json" in set(options(commands()[name]))


@pytest.mark.parametrize(
    "name", sorted(set(FUNCTIONS) - {"validate", "schema", "models", "stats", "lsystem", "doctor", "report"})
)
def test_long_work_can_be_quiet(name: str) -> None:
    assert "--quiet" in set(options(commands()[name]))
    assert any("progress" in inspect.signature(one).parameters for one in FUNCTIONS[name])


def test_all_that_is_offered_is_there_and_documented() -> None:
    for name in fg.__all__:
        if name != "__version__":
            assert inspect.getdoc(getattr(fg, name)), name
    assert set(dir(fg)) >= set(fg.__all__)
    with pytest.raises(AttributeError, match="no attribute 'plants_of_mars'"):
        _ = fg.plants_of_mars  # type: ignore[attr-defined]
