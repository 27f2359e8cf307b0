"""A community's history -> files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from forestgen.community.history import write_history
from forestgen.community.plots import plot_curves, plot_map
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.stages.plan import Plan

_CURVE_POINTS = 400
CURVES_BYTES = 500_000_000  # of memory, for the snapshots behind the curves
_BYTES_PER_ROW = 70  # of a snapshot


class Thinned:
    """Evenly spaced snapshots, as many as memory allows: where there are too many, every second one goes.

    Parameters
    ----------
    last_step : the step of the last snapshot, which is always kept.
    most : snapshots to keep at most.
    most_bytes : memory that they may take.
    """

    def __init__(self, last_step: int, *, most: int = _CURVE_POINTS, most_bytes: int = CURVES_BYTES) -> None:
        self._last_step, self._most_bytes = last_step, most_bytes
        self._stride = -(-last_step // most) or 1
        self._kept: dict[int, Population] = {}

    def add(self, step: int, population: Population) -> None:
        """Keep the snapshot of a step, if it is one of those to keep."""
        if step % self._stride and step != self._last_step:
            return
        self._kept[step] = population
        while len(self._kept) > 2 and _BYTES_PER_ROW * sum(map(len, self._kept.values())) > self._most_bytes:
            self._stride *= 2
            self._kept = {k: one for k, one in self._kept.items() if k % self._stride == 0 or k == self._last_step}

    def snapshots(self) -> list[Population]:
        """What was kept, in the order of time."""
        return list(self._kept.values())


def write_community(folder: Path, plan: Plan, snapshots: Iterator[Population], map_steps: Sequence[int]) -> Population:
    """Write history.parquet, a map for each of `map_steps` (by default the last) and curves.png; the last snapshot.

    `check_map_steps` tells whether the simulation reaches `map_steps`.
    """
    wanted = set(map_steps) or {plan.steps}
    curve, maps = Thinned(plan.steps), dict[int, Population]()
    last: list[Population] = []

    def noted() -> Iterator[Population]:
        for step, population in enumerate(snapshots):
            curve.add(step, population)
            if step in wanted:
                maps[step] = population
            last[:] = [population]
            yield population

    write_history(folder / "history.parquet", noted())
    periodic, colours = bool(getattr(plan.model_parameters, "periodic", False)), map_colours(plan)
    for step, population in maps.items():
        plot_map(population, plan.site, colours, folder / f"map-{step:06d}.png", periodic=periodic)
    plot_curves(curve.snapshots(), plan.site, colours, folder / "curves.png")
    return last[0]


def check_map_steps(plan: Plan, map_steps: Sequence[int]) -> None:
    """Raise `RecipeError` unless all of `map_steps` are steps of the simulation."""
    for step in map_steps:
        if not 0 <= step <= plan.steps:
            expected = f"a step from 0 to {plan.steps}"
            raise RecipeError("no such step", where="--map-step", expected=expected, got=str(step))


def map_colours(plan: Plan) -> dict[str, str]:
    """Colours of species on maps, as their files give them; the plots choose for the others."""
    return {name: species.map_colour for name, species in plan.drawn.species.items() if species.map_colour}
