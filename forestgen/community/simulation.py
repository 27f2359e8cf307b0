"""Recipe -> population."""

from __future__ import annotations

import time
from collections.abc import Iterator

from forestgen.community.community_cache import (
    WORTHWHILE_S,
    as_kept,
    community_key,
    community_store,
    keep_community,
    load_community,
)
from forestgen.community.model import simulate
from forestgen.community.plan import CommunityPlan
from forestgen.community.population import Population
from forestgen.core.progress import Progress


def snapshots(plan: CommunityPlan, progress: Progress, start: Population | None = None) -> Iterator[Population]:
    """The community at step 0, 1, ..., as the recipe asks; or from `start` on, a snapshot of the same simulation."""
    seed, first = plan.drawn.image_seed, 0 if start is None else start.step
    with progress.stage("community", plan.steps + 1 - first) as advance:
        history = simulate(plan.model, plan.parameters, plan.site, plan.ecologies, seed, steps=plan.steps, start=start)
        for population in history:
            advance(1)
            yield population


def final_population(plan: CommunityPlan, progress: Progress) -> Population:
    """The community at the recipe's last step, from the cache if it was simulated before."""
    store = community_store()
    key = None if store is None else community_key(plan)
    kept = None if store is None or key is None else load_community(store, key)
    if kept is not None:
        return kept
    began = time.monotonic()
    last: Population | None = None
    for population in snapshots(plan, progress):
        last = population
    assert last is not None  # step 0 is always there
    last = as_kept(last)
    if store is not None and key is not None and time.monotonic() - began >= WORTHWHILE_S:
        keep_community(store, key, last)
    return last
