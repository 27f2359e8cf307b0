"""The contract between a community model and everything after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.modules import Modules


class Status(IntEnum):
    """State of a plant in its community. The numbers are written to files: never renumber."""

    GROWING = 0
    DOMINATED = 1
    MATURE = 2
    DEAD = 3


@dataclass(frozen=True)
class Population:
    """A snapshot of a community: one row a plant, sorted by plant_id.

    A plant_id is stable for the plant's life, never reused, never 0. Together with what the simulation was started
    with, a snapshot holds everything that the future depends on (`CommunityModel.resume`).
    """

    time_yr: float
    species_names: tuple[str, ...]  # species index -> name in the recipe
    plant_id: NDArray[np.uint32]  # (N,)
    species: NDArray[np.uint16]  # (N,) index into species_names
    position_m: NDArray[np.float64]  # (N, 3) metres, world; z is 0 until the scene puts plants on its terrain
    radius_m: NDArray[np.float64]  # (N,) radius of the ecological neighbourhood
    height_m: NDArray[np.float64]  # (N,)
    age_yr: NDArray[np.float64]  # (N,)
    status: NDArray[np.uint8]  # (N,) Status
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # (N,) each, a model's own
    step: int = 0  # of the simulation
    state: Mapping[str, Any] = field(default_factory=dict)  # what a model knows besides its plants, plain as in JSON
    maps: Mapping[str, NDArray[np.float64]] = field(
        default_factory=dict
    )  # (rows, cols) each, row 0 at y = 0: of the ground
    modules: Modules | None = None  # of plants that grow by branch modules; None: a model of whole plants

    def __post_init__(self) -> None:
        n = len(self.plant_id)
        shapes = {
            "species": (n,),
            "position_m": (n, 3),
            "radius_m": (n,),
            "height_m": (n,),
            "age_yr": (n,),
            "status": (n,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {getattr(self, name).shape}")
        if n and (self.plant_id[0] == 0 or np.any(np.diff(self.plant_id.astype(np.int64)) <= 0)):
            raise ValueError(f"plant_id must be positive, unique and sorted, got {_unsorted(self.plant_id)}")
        if self.modules is not None and self.modules.plants != n:
            raise ValueError(f"modules must be those of {n} plants, got {self.modules.plants}")

    def __len__(self) -> int:
        return len(self.plant_id)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the model wants people to know, as that not all plants found a place."""
        return tuple(self.state.get("notes", ()))


def _unsorted(plant_id: NDArray[np.uint32]) -> str:
    """The first id that is not above the one before."""
    before = np.concatenate([[0], plant_id[:-1].astype(np.int64)])
    row = int(np.flatnonzero(plant_id <= before)[0])
    return f"{plant_id[row]} in row {row}" + (f" after {before[row]}" if row else "")
