"""Recipes: `load` reads one, and everything that a recipe can make is a method of `Recipe`.

Its methods that make images and that measure are in rendering.py.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from forestgen.api.display import display_of
from forestgen.api.rendering import Rendering
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.arguments import PathLike, listed, path_of, paths_of, plain_copy, shown, texts_of, whole_of
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.core.figures import count, show_bytes
from forestgen.core.progress import Progress, Timings
from forestgen.dataset.frame import Frame
from forestgen.recipe.draws import find_written
from forestgen.recipe.load import LoadedRecipe, Loading, RecipeSource, Source, read_recipe, read_source
from forestgen.recipe.messages import Explainer
from forestgen.recipe.sources import dotted

if TYPE_CHECKING:
    from forestgen.api.stands import Stand
    from forestgen.scene.plan import Plan

Overrides = Mapping[str, Any] | Sequence[str] | None
_MOST_STEPS = 10**9


def load(
    source: PathLike | Mapping[str, Any] | Frame,
    set: Overrides = (),  # noqa: A002 - the name of the option on the command line
    *,
    allow_folders: PathLike | Sequence[PathLike] = (),
) -> Recipe:
    """Read a recipe and check it.

    Parameters
    ----------
    source : path of a YAML file, or a mapping with the same keys, or the YAML itself, a text of several lines; paths in
        a mapping or a text are relative to the working folder. Or a frame, whose recipe makes it again.
    set : values that replace those of the recipe: ``{"sky.turbidity": 5, "cameras.0.size_px": [640, 480]}``, or texts
        ``["sky.turbidity=5"]`` whose values are YAML; None: nothing.
    allow_folders : folders besides the recipe's own that this recipe, and all later ones of this process, may read
        files from.

    Raises
    ------
    RecipeError, AssetError : with `place`, `expected`, `got` and `hint`; `errors` has all that were found.
    """
    if folders := paths_of(allow_folders, "allow_folders"):
        from forestgen.recipe.assets import allow_folders as allow

        allow(folders)
    return Recipe(source, set)


def _texts(overrides: Overrides) -> list[str]:
    """Overrides as ``key=YAML``."""
    if overrides is None:
        return []
    if not isinstance(overrides, Mapping):
        return texts_of(overrides, "set")
    return [f"{key}={_yaml(key, plain_copy(value, f'set: {key}'))}" for key, value in overrides.items()]


def _yaml(key: str, value: Any) -> str:
    """JSON, which is YAML; arrays and NumPy's numbers as lists and numbers."""
    try:
        return json.dumps(value, default=lambda one: one.tolist(), allow_nan=False)
    except (TypeError, ValueError, AttributeError) as error:
        expected = "a number, a text, a list or a mapping"
        raise RecipeError(
            "this value cannot be set", where=f"set: {key}", expected=expected, got=shown(value)
        ) from error


_MOST_CAMERAS = 5  # in the text of a validation


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


class Recipe(Rendering):
    """A recipe that has passed the checks of its text. Objects do not change; `set` returns another one.

    `source` and `set` are those of `load`. The source is read once: later changes of a file or a mapping do not count.
    """

    def __init__(
        self,
        source: PathLike | Mapping[str, Any] | Frame | RecipeSource,
        set: Overrides = (),  # noqa: A002 - the name of the option on the command line
    ) -> None:
        if isinstance(source, Frame):
            source = read_source(source.recipe, folder=source.recipe_folder)
        elif not isinstance(source, RecipeSource):
            is_content = isinstance(source, Mapping) or (isinstance(source, str) and "\n" in source)
            source = read_source(source if is_content else path_of(source, "source"))  # type: ignore[arg-type]
        self._source, self._overrides = source, tuple(_texts(set))
        self._loaded = load_checked(self._source, self._overrides)

    @property
    def name(self) -> str:
        """Of its file, without the ending."""
        return self._loaded.path.stem

    @property
    def images(self) -> int:
        """How many images it makes unless another count is asked for."""
        return self._loaded.images

    @property
    def seed(self) -> int:
        return self._loaded.seed

    @property
    def hash(self) -> str:
        """SHA-256 of all that the recipe says."""
        return self._loaded.hash

    @property
    def data(self) -> dict[str, Any]:
        """Everything the recipe says, defaults filled in, as plain values; a copy."""
        return json.loads(json.dumps(self._loaded.complete))  # type: ignore[no-any-return]

    @property
    def yaml(self) -> str:
        """The same as YAML text."""
        from forestgen.recipe.sources import yaml_text

        return yaml_text(self._loaded.complete)

    def set(self, values: Overrides) -> Recipe:
        """The recipe with other values; see `load`."""
        return Recipe(self._source, (*self._overrides, *_texts(values)))

    def validate(self) -> Validation:
        """Check all that can be checked without simulating, and describe what the recipe makes.

        Raises
        ------
        RecipeError, AssetError, ResourceError : what is wrong, or would not fit into memory.
        """
        from forestgen.scene.plan import check_plan, estimate_bytes

        loaded = self._loaded
        plan = check_plan(loaded)
        drawn = plan.drawn.recipe
        render_bytes, simulate_bytes = (
            sum(estimate_bytes(plan, simulate_only=only).values()) for only in (False, True)
        )
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

    def simulate(
        self,
        out: PathLike | None = None,
        *,
        map_steps: Sequence[int] = (),
        resume: PathLike | None = None,
        from_step: int | None = None,
        graphs: PathLike | Sequence[PathLike] = (),
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> Stand:
        """Simulate the plant community of the first image.

        Parameters
        ----------
        out : folder for its history, statistics and maps; None: nothing is written.
        map_steps : steps to draw a map of; by default the last.
        resume : a history.parquet that the recipe made with fewer steps, to go on from.
        from_step : of that history; by default its last.
        graphs : files for the branches of the last step: .parquet, .csv, .gltf, .glb, .obj, .usda, .usdc.
        overwrite : replace a previous output.
        progress : None or True: shown; False: silent; or a listener, see `forestgen.api.display`.

        Raises
        ------
        RecipeError, ResourceError, OutputError
        """
        from forestgen import pipeline
        from forestgen.api.stands import Stand

        if from_step is not None and resume is None:
            raise RecipeError(
                "no history to go on from", parameter="from_step", expected="`resume='history.parquet'` with it"
            )

        def step(value: Any, parameter: str) -> int:
            return whole_of(value, parameter, -_MOST_STEPS, _MOST_STEPS)

        folder, display = None if out is None else path_of(out, "out", output=True), display_of(progress)
        with display.running():
            summary = pipeline.simulate(
                self._loaded,
                folder,
                map_steps=[step(one, "map_steps") for one in listed(map_steps, "map_steps", "steps")],
                resume=None if resume is None else path_of(resume, "resume"),
                from_step=None if from_step is None else step(from_step, "from_step"),
                graphs=paths_of(graphs, "graphs", output=True),
                overwrite=overwrite,
                progress=display,
                timings=Timings(),
            )
        return Stand(summary, folder)

    def __repr__(self) -> str:
        return f"<Recipe {self._loaded.path}: {self.images} image{'' if self.images == 1 else 's'}>"


def _notes(plan: Plan) -> Iterator[str]:
    reason = plan.community.empty_reason
    if reason:
        yield reason
    for name, surface in plan.views.below_ground.items():
        yield f"the camera {name} stands below {surface}"
    yield from plan.views.check_outside_of_buildings()


def load_checked(source: Source | RecipeSource, overrides: Sequence[str] = ()) -> LoadedRecipe:
    """Read a recipe as `load_recipe` does; its errors hold those of the community model and of plants' generators.

    Of a recipe that `load_recipe` takes, the name of the community model is checked, and the rest left to `check_plan`,
    which raises all of the latter.

    `source`: a file, or the content of one, as a mapping or a text of several lines; paths in that are relative to the
    working folder. Or what `read_source` made of one.
    """
    loading = read_recipe(source, overrides)
    section = loading.community if isinstance(loading.community, Mapping) else {}
    name = section.get("model") if isinstance(section.get("model"), str) else None  # None: it is drawn, or no name
    if name is not None:
        loading.errors.attempt(COMMUNITY_MODELS.check, name, where=loading.sources.where(("community", "model")))
    if loading.errors and loading.sound is not None:
        from forestgen.scene.plan import collect_plan

        with suppress(ResourceError):  # raised when the recipe is right
            collect_plan(loading.sound.draw(0), loading.errors, loading.stand_ins)
        _check_keys(loading, dict(section), name)
    return loading.whole()


def _check_keys(loading: Loading, section: dict[str, Any], name: str | None) -> None:
    """Add the errors of the keys of a community that could not be checked as a whole.

    Of an unknown model, the keys that all models have are checked. Values that are drawn are left out.
    """
    from forestgen.community.model import CommunityParameters

    known = name if name in COMMUNITY_MODELS else None
    if not section or (known and "community" not in loading.stand_ins):
        return
    section.pop("model", None)
    parameters = COMMUNITY_MODELS.load(known).Parameters if known else CommunityParameters
    left_out = {_second(place) for place in loading.errors.places}
    left_out |= {str(keys[1]) for keys in find_written({"community": section}) if len(keys) > 1}
    data = {
        key: value
        for key, value in section.items()
        if key not in left_out and (known or key in CommunityParameters.model_fields)
    }
    try:
        parameters.model_validate(data, context={"folder": Path()})
    except ValidationError as failure:
        error = Explainer(parameters, data, loading.sources, ("community",), {}).error(failure)
        for one in error.errors:
            if _second(one.where or "") in data:  # a key that was left out is not missing
                loading.errors.add(one)


def _second(place: str) -> str:
    """The community's key in an error's place, such as ``stand.yaml:7: community.steps``; empty: none."""
    keys = place.rpartition(": ")[2].split(".")
    return keys[1] if keys[0] == "community" and len(keys) > 1 else ""
