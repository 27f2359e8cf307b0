"""Everything that can be known to be wrong before anything is simulated.

A `Plan` is a drawn recipe whose model and generators are found, whose parameters are checked, and that fits into this
machine's memory by estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from forestgen.community.model import Site, SpeciesEcology
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.plants.registry import GENERATORS
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.recipe.species import Species

# Kept free for the operating system and for what no estimate sees.
_SHARE_OF_MEMORY = 0.8
_LOADED_RENDERER_BYTES = 700_000_000
_BYTES_PER_SAMPLE = 5 + 16  # an identity sample, and the sorting of it
_BYTES_PER_PIXEL = 400  # radiance sums in double precision, buffers, channels on their way to files
_BYTES_PER_TRIANGLE = 260  # mesh, two scenes with their trees, normals' table


@dataclass(frozen=True)
class Plan:
    """A drawn recipe with its model and generators."""

    drawn: DrawnRecipe
    model: Any  # a CommunityModel
    model_parameters: BaseModel
    generator_parameters: Mapping[str, BaseModel]  # by species

    @property
    def site(self) -> Site:
        return Site(self.drawn.recipe.site.size_m)

    @property
    def ecologies(self) -> list[SpeciesEcology]:
        return [_ecology(name, species) for name, species in self.drawn.species.items()]

    @property
    def steps(self) -> int:
        return int(getattr(self.model_parameters, "steps", 0))


def _ecology(name: str, species: Species) -> SpeciesEcology:
    law = species.allometry.height_m
    return SpeciesEcology(
        name=name, height_scale=law.scale, height_exponent=law.exponent, **species.ecology.model_dump()
    )


def make_plan(drawn: DrawnRecipe) -> Plan:
    """Find and check the community model and the plant generators that a drawn recipe names.

    Raises
    ------
    RecipeError : an unknown model or generator, or parameters that it rejects; with file, line and key.
    """
    community = drawn.recipe.community
    model = COMMUNITY_MODELS.load(community.model, where=drawn.where("community", "model"))
    generators = {}
    for name, species in drawn.species.items():
        keys = ("species", name, "plant")
        generator = GENERATORS.load(species.plant.generator, where=drawn.where(*keys, "generator"))
        generators[name] = drawn.parse(generator.Parameters, species.plant.parameters, keys)
    _check_cameras(drawn)
    return Plan(drawn, model, drawn.parse(model.Parameters, community.parameters, ("community",)), generators)


def check_plan(loaded: LoadedRecipe, *, simulate_only: bool = False) -> Plan:
    """Check a recipe at the ends of all of its distributions; the plan of its first image.

    Raises
    ------
    RecipeError : see `make_plan`.
    ResourceError : more memory than this machine has free would be needed.
    """
    plans = [make_plan(drawn) for drawn in loaded.probes()]
    for plan in plans:
        check_memory(plan, simulate_only=simulate_only)
    return plans[0]


def why_barren(plan: Plan) -> str | None:
    """Why no plant can ever grow from this recipe, or None if some may: an empty site is no error, but never a surprise."""
    parameters = plan.model_parameters
    if getattr(parameters, "program", None) == "self_thinning":
        empty = getattr(parameters, "initial_plants_per_ha", None) == 0
        return "no plant can grow: community.initial_plants_per_ha is 0" if empty else None
    if plan.steps == 0:
        return "no plant can grow: community.steps is 0, and succession begins on bare ground"
    if not any(one.seedlings_per_ha_per_yr for one in plan.ecologies):
        return "no plant can grow: ecology.seedlings_per_ha_per_yr is 0 for every species"
    return None


def _check_cameras(drawn: DrawnRecipe) -> None:
    """Clouds are traced apart from the plants, which a camera inside or above them would see through."""
    clouds = drawn.recipe.sky.clouds
    if clouds.type == "none":
        return
    for index, camera in enumerate(drawn.recipe.cameras):
        if camera.position_m[2] >= clouds.base_m:
            raise RecipeError(
                "the camera stands in or above the clouds",
                where=drawn.where("cameras", index, "position_m"),
                expected=f"a height below sky.clouds.base_m = {clouds.base_m:g} m",
                got=f"{camera.position_m[2]:g} m",
                hint="lower the camera, raise base_m, or set sky.clouds to none",
            )


def estimate_bytes(plan: Plan, *, simulate_only: bool = False) -> dict[str, int]:
    """Peak memory by what takes it, estimated without simulating."""
    recipe = plan.drawn.recipe
    community = plan.model.estimate_bytes(plan.model_parameters, plan.site, plan.ecologies)
    if simulate_only:
        return {"community": community}
    pixels = max(camera.size_px[0] * camera.size_px[1] for camera in recipe.cameras)
    exemplars = recipe.plants.exemplars_per_species * len(plan.drawn.species)
    clouds = recipe.sky.clouds
    cells = 0.0 if clouds.type == "none" else (clouds.extent_m / 26) ** 2 * max(8, clouds.thickness_m / 13)
    return {
        "community": community,
        "renderer": _LOADED_RENDERER_BYTES,
        "images": pixels * (_BYTES_PER_PIXEL + recipe.labels.samples * _BYTES_PER_SAMPLE),
        "plants": exemplars * 100_000 * _BYTES_PER_TRIANGLE,
        "clouds": int(cells * 60),
    }


def check_memory(plan: Plan, *, simulate_only: bool = False) -> None:
    """Raise `ResourceError` if the estimate does not fit into the memory that is free now."""
    import psutil

    free = int(psutil.virtual_memory().available * _SHARE_OF_MEMORY)
    parts = estimate_bytes(plan, simulate_only=simulate_only)
    need = sum(parts.values())
    if need <= free:
        return
    largest = max(parts, key=lambda name: parts[name])
    where, hint = {
        "community": (("community",), "make the site smaller, or lower species' seedlings_per_ha_per_yr"),
        "images": (("cameras",), "make the images smaller, or lower labels.samples"),
        "plants": (("plants", "exemplars_per_species"), "lower plants.exemplars_per_species"),
        "clouds": (("sky", "clouds"), "make sky.clouds.extent_m smaller"),
        "renderer": (("render",), "free some memory"),
    }[largest]
    raise ResourceError(
        f"this would need more memory than is free, most of it for the {largest}",
        where=plan.drawn.where(*where),
        expected=f"at most {_show_bytes(free)}",
        got=f"about {_show_bytes(need)} ({largest}: {_show_bytes(parts[largest])})",
        hint=hint,
    )


def _show_bytes(count: int) -> str:
    for unit, size in (("TB", 1e12), ("GB", 1e9)):
        if count >= size:
            return f"{count / size:,.1f} {unit}"
    return f"{count / 1e6:,.0f} MB"
