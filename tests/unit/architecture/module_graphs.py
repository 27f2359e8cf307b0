"""Random module graphs for tests: modules that grow from terminals of grown modules, as the model makes them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import terminal_pose
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import Tables, load_prototypes, tables_of
from forestgen.recipe.species import PlantType


def plant_type(**changes: Any) -> PlantType:
    keys = {
        "life_span_yr": 100.0,
        "root_vigour_max": 100.0,
        "growth_rate_per_yr": 0.2,
        "apical_control": 0.8,
        "determinacy": 0.8,
    }
    return PlantType(**{**keys, **changes})


def shipped_tables(*types: PlantType) -> Tables:
    return tables_of(load_prototypes(), types or (plant_type(),))


def unit_quaternions(rng: np.random.Generator, n: int) -> NDArray[np.float32]:
    values = rng.normal(size=(n, 4))
    return (values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.float32)


def upright(n: int) -> NDArray[np.float32]:
    return np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (n, 1))


def single(tables: Tables, prototype: Any, age: Any, rotation: NDArray[np.float32] | None = None) -> Modules:
    """Plants of one module each: prototypes and ages (P,), at the origin."""
    prototype, age = np.broadcast_arrays(np.atleast_1d(prototype), np.atleast_1d(age))
    n = len(prototype)
    zero = np.zeros(n, dtype=np.float32)
    return Modules(
        first=np.arange(n + 1),
        number=np.zeros(n, dtype=np.uint32),
        parent=np.full(n, -1, dtype=np.int32),
        node=np.full(n, -1, dtype=np.int16),
        prototype=prototype.astype(np.uint8),
        age=age.astype(np.float32),
        age_yr=zero,
        base_m=np.zeros((n, 3), dtype=np.float32),
        rotation=upright(n) if rotation is None else rotation,
        vigour=zero,
        light=zero,
        disused_m2=zero,
    )


def random_plants(
    tables: Tables, types: NDArray[Any], modules_a_plant: int, rng: np.random.Generator, *, disused: bool = True
) -> Modules:
    """Plants of `types` (P,) with up to so many modules; about half the modules that bear nothing still grow."""
    rows: dict[str, list[Any]] = {name: [] for name in ("parent", "node", "prototype", "age", "base", "rotation")}
    first = [0]
    for kind in types:
        begin = first[-1]
        size = int(rng.integers(1, modules_a_plant + 1))
        free: list[tuple[int, int]] = []
        for own in range(size):
            bearer, node = (-1, -1) if own == 0 else free.pop(int(rng.integers(len(free))))
            s = int(rng.integers(len(tables.names)))
            base = np.zeros(3)
            if bearer >= 0:
                row = begin + bearer
                base = terminal_pose(
                    tables, [kind], [rows["prototype"][row]], [rows["base"][row]], [rows["rotation"][row]], [node]
                )[0][0]
            free += [(own, int(n)) for n in tables.terminal[s, : tables.terminals[s]]]
            values = bearer, node, s, float(tables.mature_age[kind]), base, unit_quaternions(rng, 1)[0]
            for name, value in zip(rows, values, strict=True):
                rows[name].append(value)
        bearing = set(rows["parent"][begin:])
        for own in range(size):
            if own not in bearing and rng.random() < 0.5:
                rows["age"][begin + own] *= float(rng.random())
        first.append(begin + size)
    m = first[-1]
    zero = np.zeros(m, dtype=np.float32)
    return Modules(
        first=np.array(first),
        number=np.concatenate([np.arange(n) for n in np.diff(first)]).astype(np.uint32),
        parent=np.array(rows["parent"], dtype=np.int32),
        node=np.array(rows["node"], dtype=np.int16),
        prototype=np.array(rows["prototype"], dtype=np.uint8),
        age=np.array(rows["age"], dtype=np.float32),
        age_yr=zero,
        base_m=np.array(rows["base"], dtype=np.float32),
        rotation=np.array(rows["rotation"], dtype=np.float32),
        vigour=zero,
        light=zero,
        disused_m2=(rng.random(m) * 1e-4 * disused).astype(np.float32),
    )


def turned_about_vertical(modules: Modules, angle_rad: float) -> Modules:
    """The same plants, each turned about its foot."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    a, d = np.cos(angle_rad / 2), np.sin(angle_rad / 2)  # the quaternion a + d k, from the left
    w, x, y, z = modules.rotation.T.astype(np.float64)
    rotation = np.stack([a * w - d * z, a * x - d * y, a * y + d * x, a * z + d * w], axis=-1)
    parts = {name: getattr(modules, name) for name in modules.__dataclass_fields__}
    parts |= {"base_m": (modules.base_m @ turn.T).astype(np.float32), "rotation": rotation.astype(np.float32)}
    return Modules(**parts)
