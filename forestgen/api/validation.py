"""What a valid recipe makes: the answer of `Recipe.validate`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from forestgen.core.figures import count, show_bytes
from forestgen.recipe.load import LoadedRecipe
from forestgen.recipe.sources import dotted
from forestgen.scene.plan import Plan, estimate_bytes
from forestgen.scene.planning import check_plan

_MOST_CAMERAS = 5


@dataclass(frozen=True)
class CameraSummary:
    """One entry of the recipe's cameras."""

    name: str
    size_px: tuple[int, int]
    frames: int  # of an image


@dataclass(frozen=True)
class Validation:
    """What a recipe makes, checked without simulating."""

    recipe: str  # where it was read from
    images: int
    cameras: tuple[CameraSummary, ...]
    site_size_m: tuple[float, float]
    terrain: str
    community: str
    steps: int
    species: tuple[str, ...]
    drawn: tuple[str, ...]  # keys whose values each image draws
    sampling: str | None
    render_bytes: int  # of memory, an upper estimate
    simulate_bytes: int
    hash: str
    notes: tuple[str, ...]

    @property
    def frames(self) -> int:
        return self.images * sum(camera.frames for camera in self.cameras)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {"valid": True, **asdict(self), "frames": self.frames}

    def __str__(self) -> str:
        return "\n".join([f"{self.recipe}: valid", *(f"  {name:<10} {text}" for name, text in self._rows())])

    def _rows(self) -> Iterator[tuple[str, str]]:
        yield (
            "makes",
            f"{count(self.frames, 'frame')}: {count(self.images, 'image')} x " + count(len(self.cameras), "camera"),
        )
        for camera in self.cameras[:_MOST_CAMERAS]:
            along = f", {camera.frames} images" if camera.frames > 1 else ""
            yield "", f"{camera.name}, {camera.size_px[0]} x {camera.size_px[1]} px{along}"
        if len(self.cameras) > _MOST_CAMERAS:
            yield "", "..."
        yield "site", f"{self.site_size_m[0]:g} x {self.site_size_m[1]:g} m, {self.terrain}"
        yield "community", f"{self.community}, {count(self.steps, 'step')}"
        yield "species", ", ".join(self.species)
        yield "drawn", ", ".join(self.drawn) or "nothing but the random numbers"
        if self.sampling is not None:
            yield "sampling", self.sampling
        memory = f"{show_bytes(self.render_bytes)} to render, {show_bytes(self.simulate_bytes)} to simulate alone"
        yield "memory", f"up to about {memory}"
        yield "hash", self.hash


def validation_of(loaded: LoadedRecipe) -> Validation:
    """Check a recipe at the ends of all of its distributions; see `Recipe.validate`."""
    plan = check_plan(loaded)
    drawn = plan.drawn.recipe
    render_bytes, simulate_bytes = (sum(estimate_bytes(plan, simulate_only=only).values()) for only in (False, True))
    return Validation(
        recipe=str(loaded.path),
        images=loaded.images,
        cameras=tuple(
            CameraSummary(camera.name, (camera.size_px[0], camera.size_px[1]), camera.frames)
            for camera in drawn.cameras
        ),
        site_size_m=(drawn.site.size_m[0], drawn.site.size_m[1]),
        terrain=drawn.site.terrain.kind,
        community=drawn.community.model,
        steps=plan.community.steps,
        species=tuple(drawn.species),
        drawn=tuple(dotted(keys) for keys in loaded.distributions),
        sampling=None if loaded.draws.sampler is None else loaded.draws.sampler.describe(),
        render_bytes=render_bytes,
        simulate_bytes=simulate_bytes,
        hash=loaded.hash,
        notes=tuple(_notes(plan)),
    )


def _notes(plan: Plan) -> Iterator[str]:
    reason = plan.community.empty_reason
    if reason:
        yield reason
    for name in plan.views.below_ground:
        yield f"the camera {name} stands below the ground"
    yield from plan.views.check_outside_of_buildings()
