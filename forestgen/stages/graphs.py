"""The skeletal graphs of a community's plants -> files: each branch with its bearer, diameter and plant type."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from forestgen.architecture.graph_files import GRAPH_FORMATS, write_graph
from forestgen.architecture.prototypes import load_prototypes
from forestgen.architecture.skeletal_graph import skeletal_graph
from forestgen.architecture.tables import tables_of
from forestgen.community.branch_modules.changes import parameters_at
from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.branch_modules.traits import STAND_IN
from forestgen.community.population import Population
from forestgen.core.errors import OutputError, RecipeError
from forestgen.stages.plan import Plan


def check_graphs(plan: Plan, paths: Sequence[Path]) -> None:
    """Refuse, before anything is simulated, graphs of plants without branches and files that cannot be written."""
    if paths and not isinstance(plan.model_parameters, BranchModulesParameters):
        raise RecipeError(
            "plants of this community have no branches of their own",
            parameter="graphs",
            expected="community.model: branch_modules",
            got=plan.drawn.recipe.community.model,
            hint="forestgen plant NAME --out exports a single plant",
        )
    for path in paths:
        if path.suffix.lower() not in GRAPH_FORMATS:
            raise RecipeError(
                "no format for skeletal graphs",
                parameter="graphs",
                expected=f"a name that ends with {', '.join(GRAPH_FORMATS)}",
                got=str(path),
            )
        if path.is_dir() or not os.access(path.parent, os.W_OK):
            raise OutputError(
                "the graph cannot be written",
                where=str(path),
                expected="a file in a folder that there is, and that may be written to",
                got="a folder" if path.is_dir() else "no such folder" if not path.parent.is_dir() else "no permission",
            )


def write_graphs(plan: Plan, population: Population, paths: Sequence[Path]) -> None:
    """Write the graphs of all plants of a snapshot, at their places in the world; z counts from the ground's height.

    Raises
    ------
    OutputError : a file cannot be written.
    """
    parameters, modules = plan.model_parameters, population.modules
    if not paths or modules is None or not isinstance(parameters, BranchModulesParameters):
        return
    known = {one.name: one.modules for one in plan.ecologies if one.modules is not None}
    now, types = parameters_at(parameters, known, population.step)
    tables = tables_of(
        load_prototypes(),
        [types.get(name, STAND_IN) for name in population.species_names],
        sphere_scale=now.sphere_scale,
    )
    graph = skeletal_graph(tables, modules, population.species, np.flatnonzero(np.diff(modules.first)))
    foot_m = population.position_m.copy()
    if plan.site.height is not None:
        foot_m[:, 2] = plan.site.height(foot_m[:, 0], foot_m[:, 1])
    columns = {
        "plant_id": population.plant_id,
        "species": np.array(population.species_names, dtype=np.str_)[population.species],
    }
    for path in paths:
        write_graph(path, graph, foot_m=foot_m, columns=columns)
