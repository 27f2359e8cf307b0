"""An instrument: the mean height of the stand's tallest trees, as foresters measure it.

| key | |
|---|---|
| trees_per_ha | how many of the tallest trees count, for each hectare of the site; default 100 |

Example: ``forestgen measure tallest RECIPE --key trees_per_ha=200``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
from pydantic import Field

from forestgen.core.progress import Progress, Timings
from forestgen.instruments.instrument import Instrument, Reading
from forestgen.recipe.fields import Section
from forestgen.recipe.load import LoadedRecipe
from forestgen.scene.build import BuiltScene


class TallestKeys(Section):
    """Keys of the instrument."""

    trees_per_ha: float = Field(100.0, gt=0, description="how many of the tallest trees count")


@dataclass(frozen=True)
class TopHeight(Reading):
    """What was measured."""

    trees: int
    height_m: float

    def lines(self) -> Iterator[str]:
        yield f"top height {self.height_m:.2f} m, the mean of {self.trees} trees"

    def content(self, ending: str, loaded: LoadedRecipe) -> bytes:
        return json.dumps({"recipe_hash": loaded.hash, **asdict(self)}).encode()


class Tallest(Instrument[TallestKeys, TopHeight]):
    """The tallest trees."""

    name = "tallest"
    Parameters = TallestKeys

    def measure(self, scene: BuiltScene, keys: TallestKeys, progress: Progress, timings: Timings) -> TopHeight:
        width_m, depth_m = scene.drawn.recipe.site.size_m
        count = max(1, round(keys.trees_per_ha * width_m * depth_m / 1e4))
        highest_m = np.sort(scene.population.height_m)[-count:]
        return TopHeight(len(highest_m), float(highest_m.mean()) if len(highest_m) else 0.0)


INSTRUMENT = Tallest()
