"""Several exemplars at once: from disk where they are kept, otherwise grown, on all cores.

Threads, not processes: most of the time goes to NumPy and to compiled loops, which leave Python's lock; and a process
would first spend seconds on imports, and would run a user's script again. What grows depends on the requests alone,
never on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from forestgen.core.cache import BoundedCache, DiskCache
from forestgen.core.randomness import child_rng, child_seed
from forestgen.core.threads import cores
from forestgen.plants.build import build_exemplar, built, size_m
from forestgen.plants.cache import ExemplarRequest, keep_exemplar, load_exemplar
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.grown.build import build_grown

SHARED_BYTES = 400_000_000  # of shared exemplars in memory, at most
_shared: BoundedCache[Exemplar] = BoundedCache(SHARED_BYTES, lambda exemplar: exemplar.nbytes)


def forget_shared() -> None:
    """Keep no exemplar in memory any longer."""
    _shared.clear()


def grow_exemplar(request: ExemplarRequest) -> Exemplar:
    """The plant of a request, grown and meshed."""
    if request.box_m is not None:
        return built(request.species_name, request.species, request.parameters, request.box_m, request.radius_m)
    rng, wood, parameters = child_rng(request.seed, *request.identity), request.wood, request.parameters
    if request.grows_alone:
        from forestgen.plants.grown.alone import wood_alone  # loads a community model

        size, seed = size_m(request.species, request.radius_m), child_seed(request.seed, *request.identity, "wood")
        wood = wood_alone(request.species_name, request.species, size, seed)
        parameters = parameters.model_copy(update={"fit": "scale_all"})  # leaves reach beyond the wood
    if wood is not None:
        return build_grown(
            request.species_name,
            request.species,
            parameters,
            wood,
            request.radius_m,
            rng,
            level=request.level,
        )
    return build_exemplar(
        request.species_name, request.species, request.parameters, request.radius_m, rng, level=request.level
    )


def grow_exemplars(
    requests: Sequence[ExemplarRequest],
    *,
    store: DiskCache | None = None,
    workers: int | None = None,
    advance: Callable[[int], None] = lambda done: None,
) -> tuple[Exemplar, ...]:
    """All exemplars, in the order of the requests.

    Parameters
    ----------
    store : where exemplars are kept from run to run; None: nowhere.
    workers : threads; None: as many as there are cores.
    advance : is told, in the calling thread, how many more are done.

    Raises
    ------
    RecipeError : a plant that cannot be grown: of several, the one that is asked for first.
    """
    threads = max(1, min(workers or cores(), len(requests)))

    written: list[bool] = []  # whether each exemplar that grew is on disk now

    def made(request: ExemplarRequest) -> Exemplar:
        own = store if request.is_kept else None
        found = load_exemplar(own, request) if own is not None else None
        if found is not None:
            return found
        grown = grow_exemplar(request)
        written.append(own is not None and keep_exemplar(own, request, grown))
        return grown

    def one(request: ExemplarRequest) -> Exemplar:
        return _shared.get(request.key(), lambda: made(request)) if request.is_shared else made(request)

    results = []
    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(one, request) for request in requests]
        try:
            for future in futures:
                results.append(future.result())
                advance(1)
        except BaseException:  # Ctrl-C too: only the plants that are being grown are waited for
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    if store is not None and any(written):
        store.trim()
    return tuple(results)
