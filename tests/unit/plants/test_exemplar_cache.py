"""Exemplars from disk and from several threads are the ones that would be grown."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plant_species import read

from forestgen.core.array_serialization import pack
from forestgen.core.cache import ENVIRONMENT, DiskCache
from forestgen.core.errors import RecipeError
from forestgen.plants import growing
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.growing import (
    ExemplarRequest,
    exemplar_store,
    grow_exemplar,
    grow_exemplars,
    load_exemplar,
)
from support.error_messages import raises_error


def request_for(name: str, radius_m: float = 0.3, number: int = 0) -> ExemplarRequest:
    species, parameters = read(name)
    return ExemplarRequest(name, species, parameters, radius_m, 7, ("exemplar", name, number))


@pytest.fixture
def store(tmp_path: Path) -> DiskCache:
    return DiskCache(tmp_path / "exemplars", 10**9)


@pytest.mark.parametrize("name", ["poplar", "spruce", "fireweed"])
def test_cached_and_fresh_are_the_same_bytes(name: str, store: DiskCache) -> None:
    request = request_for(name)
    assert load_exemplar(store, request) is None
    fresh = grow_exemplar(request)
    assert store.write(request.key(), pack(fresh))
    cached = load_exemplar(store, request)
    assert cached is not None
    assert pack(cached) == pack(fresh)
    for mine, theirs in zip(fresh.organs, cached.organs, strict=True):
        for field in fields(mine.mesh):
            a, b = getattr(mine.mesh, field.name), getattr(theirs.mesh, field.name)
            assert (a is None and b is None) or (a.dtype == b.dtype and np.array_equal(a, b))
    assert (cached.species, cached.height_m, cached.leaf_area_m2) == (name, fresh.height_m, fresh.leaf_area_m2)


def test_nothing_depends_on_the_number_of_workers(store: DiskCache) -> None:
    requests = [request_for(name, radius, 1) for radius in (0.1, 0.25, 0.2) for name in ("fireweed", "poplar")]
    alone = [pack(one) for one in grow_exemplars(requests, workers=1)]
    for workers in (2, 3):
        assert [pack(one) for one in grow_exemplars(requests, workers=workers)] == alone
    assert [pack(one) for one in grow_exemplars(requests, store=store, workers=2)] == alone
    assert [pack(one) for one in grow_exemplars(requests, store=store, workers=3)] == alone
    assert store.size_bytes()[0] == len(requests)
    assert grow_exemplars([]) == ()


def test_what_is_kept_is_not_grown_again(store: DiskCache, monkeypatch: pytest.MonkeyPatch) -> None:
    requests = [request_for("fireweed", radius) for radius in (0.1, 0.2)]
    grow_exemplars(requests, store=store)
    monkeypatch.setattr(growing, "grow_exemplar", None)  # would fail
    told: list[int] = []
    assert len(grow_exemplars(requests, store=store, advance=told.append)) == sum(told) == 2


CHANGES: dict[str, Callable[[ExemplarRequest], ExemplarRequest]] = {
    "radius": lambda one: replace(one, radius_m=np.nextafter(one.radius_m, 1.0)),
    "seed": lambda one: replace(one, seed=8),
    "identity": lambda one: replace(one, identity=(*one.identity, 1)),
    "level": lambda one: replace(one, pixel_m=0.2),
    "name": lambda one: replace(one, species_name="other"),
    "parameters": lambda one: replace(one, parameters=one.parameters.model_copy(update={"fit": "none"})),
    "allometry": lambda one: replace(
        one,
        species=SimpleNamespace(
            materials=one.species.materials,
            allometry=SimpleNamespace(
                height_m=one.species.allometry.height_m, width_m=SimpleNamespace(scale=9.0, exponent=1.0)
            ),
        ),
    ),
    "materials": lambda one: replace(
        one, species=SimpleNamespace(allometry=one.species.allometry, materials={**one.species.materials, "new": 0})
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_every_input_is_in_the_key(change: str) -> None:
    request = request_for("fireweed")
    assert request.key() == request_for("fireweed").key()
    assert CHANGES[change](request).key() != request.key()


@pytest.mark.parametrize("damage", [lambda data: data[: len(data) // 2], lambda data: b"", lambda data: b"x" * 900])
def test_a_damaged_entry_is_grown_anew(damage: Callable[[bytes], bytes], store: DiskCache) -> None:
    request = request_for("fireweed")
    [fresh] = grow_exemplars([request], store=store)
    [path] = store.folder.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    [again] = grow_exemplars([request], store=store)
    assert pack(again) == pack(fresh)
    kept = load_exemplar(store, request)
    assert kept is not None
    assert pack(kept) == pack(fresh)


def test_a_folder_that_cannot_be_written_to_costs_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    request = request_for("fireweed")
    [grown] = grow_exemplars([request], store=DiskCache(tmp_path / "file" / "deep", 10**9))
    assert pack(grown) == pack(grow_exemplar(request))


def test_the_cache_may_be_turned_off(monkeypatch: pytest.MonkeyPatch) -> None:
    assert exemplar_store() is not None
    monkeypatch.setenv(ENVIRONMENT, "")
    assert exemplar_store() is None


def test_the_first_failure_in_order_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(request: ExemplarRequest) -> Exemplar:
        if request.identity[-1] in (1, 2):
            raise RecipeError(f"plant {request.identity[-1]}")
        return grow_exemplar(request)

    requests = [request_for("fireweed", 0.1, number) for number in range(4)]
    monkeypatch.setattr(growing, "grow_exemplar", failing)
    for workers in (1, 3):
        with raises_error(RecipeError):
            grow_exemplars(requests, workers=workers)


def test_an_interrupt_leaves_the_rest_ungrown(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = []
    go = threading.Event()

    def slow(request: ExemplarRequest) -> Any:
        begun.append(request)
        if len(begun) > 1:
            go.wait(10)
        return None

    def interrupt(done: int) -> None:
        go.set()
        raise KeyboardInterrupt

    monkeypatch.setattr(growing, "grow_exemplar", slow)
    with pytest.raises(KeyboardInterrupt):
        grow_exemplars([request_for("fireweed")] * 50, workers=2, advance=interrupt)
    assert len(begun) < 50
