"""A strand tree in the wind, frame after frame: the same plant, the same fit, other poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.plants.fitting import fit
from forestgen.plants.foliage import place
from forestgen.plants.generators.strands import Parameters, Rest, grow_at_rest, skeleton_of
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.strands.leaves import carried
from forestgen.plants.strands.wind import pose

Floats = NDArray[np.float64]


def poses(
    parameters: Parameters, height_m: float, width_m: float, rng: np.random.Generator, times_s: Iterable[float]
) -> Iterator[Skeleton]:
    """The plant at each time in its wind, fitted, with all its organs: ready to be meshed.

    The plant is the one that `build_exemplar` makes of the same `rng`. Its fit is that of the plant at rest, so that
    its size does not breathe. Organs by foliage rules are placed at rest and carried along.

    Parameters
    ----------
    times_s : seconds; `parameters.wind.time_s` does not count.

    Raises
    ------
    RecipeError : the plant has a `variation`, whose bends a pose would have to carry along; or as the generator does.
    """
    if parameters.variation is not None:
        raise RecipeError("a plant with a variation has no poses in the wind", where="plant.variation")
    wood_rng, foliage_rng = rng.spawn(2)
    plant = grow_at_rest(parameters, height_m, wood_rng)
    at_rest = skeleton_of(parameters, plant.branching, plant.pose, plant.organs)
    rules = [rule for rule in parameters.foliage if rule.suits(height_m)]
    at_rest = replace(
        at_rest, organs=(*at_rest.organs, *(place(rule, at_rest, height_m, foliage_rng) for rule in rules))
    )
    templates = {name: shape.template() for name, shape in parameters.shapes.items()}
    fitted = fit(at_rest, templates, parameters.fit, height_m, width_m)
    for time_s in times_s:
        yield _at(time_s, parameters, plant, at_rest, fitted)


def _at(time_s: float, parameters: Parameters, plant: Rest, at_rest: Skeleton, fitted: Skeleton) -> Skeleton:
    wind = parameters.wind.model_copy(update={"time_s": time_s})
    stance = pose(plant.branching, wind, parameters.stiffness, plant.phases_rad)
    stretch = _largest(fitted.position_m) / np.maximum(_largest(at_rest.position_m), 1e-9)
    organs = tuple(
        _sized(carried(placement, plant.pose, stance), stretch, _size(at_its_size) / max(_size(placement), 1e-12))
        for placement, at_its_size in zip(at_rest.organs, fitted.organs, strict=True)
    )
    return replace(fitted, position_m=(stance.position_m * stretch).astype(np.float32), organs=organs)


def _largest(position_m: NDArray[np.float32]) -> Floats:
    return np.asarray(np.abs(position_m).max(axis=0), dtype=np.float64)


def _size(organs: OrganPlacements) -> float:
    """Length of a blade's unit; all organs of a plant are fitted by one factor."""
    return float(np.linalg.norm(organs.frame[:1, :, 1]))


def _sized(organs: OrganPlacements, stretch: Floats, size: float) -> OrganPlacements:
    frame = organs.frame.copy()
    frame[:, :, 3] *= stretch.astype(np.float32)
    frame[:, :, :3] *= np.float32(size)
    return replace(organs, frame=frame)
