"""Recipe -> population."""

from __future__ import annotations

from collections.abc import Iterator

from forestgen.community.model import simulate
from forestgen.community.population import Population
from forestgen.core.progress import Progress
from forestgen.stages.plan import Plan


def snapshots(plan: Plan, progress: Progress, start: Population | None = None) -> Iterator[Population]:
    """The community at step 0, 1, ..., as the recipe asks; or from `start` on, a snapshot of the same simulation."""
    seed, first = plan.drawn.image_seed, 0 if start is None else start.step
    with progress.stage("community", plan.steps + 1 - first) as advance:
        history = simulate(
            plan.model, plan.model_parameters, plan.site, plan.ecologies, seed, steps=plan.steps, start=start
        )
        for population in history:
            advance(1)
            yield population


def final_population(plan: Plan, progress: Progress) -> Population:
    """The community at the recipe's last step."""
    last: Population | None = None
    for population in snapshots(plan, progress):
        last = population
    assert last is not None  # step 0 is always there
    return last
