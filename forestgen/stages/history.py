"""A community's history -> files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from forestgen.community.history import write_history
from forestgen.community.plots import plot_curves, plot_map
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.stages.plan import Plan

_CURVE_POINTS = 400  # snapshots held in memory for the curves


def write_community(
    folder: Path, plan: Plan, snapshots: Iterator[Population], map_steps: Sequence[int]
) -> Population:
    """Write history.parquet, a map for each of `map_steps` (by default the last) and curves.png; the last snapshot."""
    wanted = set(map_steps) or {plan.steps}
    for step in sorted(wanted):
        if not 0 <= step <= plan.steps:
            raise RecipeError(
                "no such step", where="--map-step", expected=f"a step from 0 to {plan.steps}", got=str(step)
            )
    stride = max(1, plan.steps // _CURVE_POINTS)
    curve: list[Population] = []
    maps: dict[int, Population] = {}
    last: list[Population] = []

    def noted() -> Iterator[Population]:
        for step, population in enumerate(snapshots):
            if step % stride == 0 or step == plan.steps:
                curve.append(population)
            if step in wanted:
                maps[step] = population
            last[:] = [population]
            yield population

    write_history(folder / "history.parquet", noted())
    periodic = bool(getattr(plan.model_parameters, "periodic", False))
    for step, population in maps.items():
        colours = map_colours(plan)
        plot_map(population, plan.site, colours, folder / f"map-{step:06d}.png", periodic=periodic)
    plot_curves(curve, plan.site, map_colours(plan), folder / "curves.png")
    return last[0]


def map_colours(plan: Plan) -> dict[str, str]:
    """Colours of species on maps, as their files give them; the plots choose for the others."""
    return {name: species.map_colour for name, species in plan.drawn.species.items() if species.map_colour}
