"""Gap fraction of the canopy, of each fisheye of the recipe that looks straight up, by zenith ring.

| field | what it is |
|---|---|
| `zenith_deg` | edges of the rings, from the zenith to the horizon |
| `gap_fraction` | by ring: share of sky among what is sky or plant; null where the image shows nothing of it |
| `samples`, `gaps` | by ring: identity samples that met sky or plants; of these, sky |
| `effective_lai` | Miller's integral over the rings of the image |
| `hinge_lai` | of the ring that holds 57.5 degrees |
| `openness` | share of the sky's solid angle that is seen |

The formulas are in labels/gap_fraction.py. Ground counts as neither; the area index is of all plant matter, wood
included. Frames of a data set have the same fields in `canopy.json`.

Example: ``forestgen measure gap_fraction RECIPE --set "cameras=[{kind: fisheye, look: up}]" --out gaps.json``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from forestgen.core.errors import RecipeError
from forestgen.core.figures import table_lines
from forestgen.core.progress import Progress, Timings
from forestgen.dataset.manifest import package_versions
from forestgen.instruments.instrument import Instrument, Reading
from forestgen.labels.gap_fraction import GapFraction, gap_fraction_of, looks_up
from forestgen.recipe.fields import Section
from forestgen.recipe.load import LoadedRecipe
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.scene.build import BuiltScene
from forestgen.scene.plan import Plan


class GapFractionKeys(Section):
    """There are none: the recipe has the cameras, and their samples in `labels.samples`."""


@dataclass(frozen=True)
class GapFractions(Reading):
    """Of each camera that looks up."""

    by_camera: Mapping[str, GapFraction]

    def lines(self) -> Iterator[str]:
        rows = [("camera", "effective LAI", "hinge LAI", "openness")]
        for name, one in self.by_camera.items():
            rows.append((name, f"{one.effective_lai:.2f}", f"{one.hinge_lai:.2f}", f"{100 * one.openness:.1f}%"))
        yield from table_lines(rows)

    def content(self, ending: str, loaded: LoadedRecipe) -> bytes:
        document = {
            "schema": "forestgen-gap-fraction/1",
            "recipe_hash": loaded.hash,
            "versions": package_versions(),
            "cameras": {name: one.as_dict() for name, one in self.by_camera.items()},
        }
        return (json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()


class GapFractionOfFisheyes(Instrument[GapFractionKeys, GapFractions]):
    """Identity samples of fisheyes; no light is traced."""

    name = "gap_fraction"
    Parameters = GapFractionKeys

    def check(self, plan: Plan, keys: GapFractionKeys) -> None:
        cameras = plan.views.all_cameras
        if not any(map(looks_up, cameras)):
            problem, expected = "no camera sees the canopy from below", "an equidistant fisheye that looks straight up"
            got = ", ".join(f"{one.name}, {one.projection}" for one in cameras[:5])
            hint = "`set='cameras=[{kind: fisheye, look: up}]'`"
            raise RecipeError(problem, where=plan.drawn.where("cameras"), expected=expected, got=got, hint=hint)

    def measure(self, scene: BuiltScene, keys: GapFractionKeys, progress: Progress, timings: Timings) -> GapFractions:
        samples = scene.drawn.recipe.labels.samples
        found = {}
        for camera in filter(looks_up, scene.spec.cameras):
            tracer = SceneTracer(scene.at(camera.time_s), timings)
            with progress.stage(f"identity {camera.name}", camera.size_px[1]) as advance:
                identity, _ = trace_identity(tracer, camera, samples=samples, timer=timings, advance=advance)
            found[camera.name] = gap_fraction_of(camera, identity)
        return GapFractions(found)


INSTRUMENT = GapFractionOfFisheyes()
