"""Cameras of a drawn recipe, and whether something is in their way: told before any image is rendered."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.community.obstacles import Obstacle
from forestgen.core.errors import RecipeError
from forestgen.core.spectrum import Band
from forestgen.recipe.camera_keys import SensorFile
from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.spectra import bands_of, load_bands
from forestgen.scene.camera_path import expand
from forestgen.scene.ground import height_field
from forestgen.scene.spec import Camera
from forestgen.scene.trunks import Trunks

LEAST_ABOVE_GROUND_M = 0.01
LEAST_FROM_TRUNKS_M = 0.05
_ROOF_M = 0.5  # its thickness, and more: a camera on the roof is outside


def drawn_cameras(drawn: DrawnRecipe, trunks: Trunks | None = None) -> list[list[Camera]]:
    """The cameras of each entry; walks go straight where no trunks are given.

    Raises
    ------
    RecipeError, AssetError : bands that no file has, or a walk without a way, with its line.
    """
    bands = _bands(drawn)
    cameras = []
    for index, section in enumerate(drawn.recipe.cameras):
        try:
            cameras.append(expand(section, height_field(drawn), trunks, bands))
        except RecipeError as cause:  # the scene knows keys only
            keys = [int(key) if key.isdigit() else key for key in (cause.where or "").split(".")]
            where = drawn.where("cameras", index, *keys)
            raise RecipeError(
                cause.problem, where=where, expected=cause.expected, got=cause.got, hint=cause.hint
            ) from cause
    return cameras


def _bands(drawn: DrawnRecipe) -> dict[SensorFile, tuple[Band, ...]]:
    bands = {}
    for index, section in enumerate(drawn.recipe.cameras):
        if section.bands is None:
            continue
        name, where = section.bands.name, drawn.where("cameras", index, "bands")
        if section.bands.text is None:
            bands[section.bands] = load_bands(name, folder=drawn.folder, where=where)
        else:
            bands[section.bands] = bands_of(section.bands.text, name, where)
    return bands


def below_ground(drawn: DrawnRecipe) -> list[tuple[int, Camera, float]]:
    """Number of the entry, camera and height above the ground, metres, of cameras that are not above it."""
    height = height_field(drawn)
    found = []
    for index, cameras in enumerate(drawn_cameras(drawn)):
        x, y, z = np.array([camera.position_m for camera in cameras]).T
        above = z - height(x, y)
        found += [(index, cameras[k], float(above[k])) for k in np.flatnonzero(above < LEAST_ABOVE_GROUND_M)]
    return found


def views_below_ground(drawn: DrawnRecipe) -> list[str]:
    """Names of the cameras, or frames of a path, that stand below the ground, of those that may."""
    return [camera.name for _, camera, _ in below_ground(drawn)]


def ground_below(drawn: DrawnRecipe, camera: Camera) -> float:
    """Height of the ground below a camera, metres, world."""
    x, y, _ = camera.position_m
    return float(height_field(drawn)(np.array([x]), np.array([y]))[0])


def check_above_ground(drawn: DrawnRecipe) -> None:
    """Refuse cameras below the ground, of entries whose `obstructed` is an error.

    Raises
    ------
    RecipeError : with the camera's line.
    """
    for index, camera, above_m in below_ground(drawn):
        section = drawn.recipe.cameras[index]
        if section.obstructed == "error":
            raise RecipeError(
                f"the camera {camera.name} stands below the ground",
                where=drawn.where("cameras", index, *_place_key(section)),
                expected=f"at least {LEAST_ABOVE_GROUND_M * 100:g} cm above the ground",
                got=f"{above_m:.3g} m",
                hint="raise it; or set obstructed: note, to look at it all the same",
            )


def in_houses(drawn: DrawnRecipe, obstacles: Sequence[Obstacle]) -> list[tuple[int, Camera, int]]:
    """Number of the entry, camera, and number of the obstacle within whose walls and roof it surely stands."""
    if not obstacles:
        return []
    feet = np.array([one.position_m for one in obstacles])
    ground_m, found = height_field(drawn)(feet[:, 0], feet[:, 1]), []
    for index, cameras in enumerate(drawn_cameras(drawn)):
        at = np.array([camera.position_m for camera in cameras])
        for number, one in enumerate(obstacles):
            inside = _is_within(one, at - [*one.position_m, float(ground_m[number])])
            found += [(index, cameras[k], number) for k in np.flatnonzero(inside)]
    return found


def _is_within(house: Obstacle, at_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) whether points lie inside, (N, 3) metres from the middle of the ground plan; walls, eaves left out.

    Whatever the parameters of its generator: walls stand at most a tenth of the house inside of its ground plan, and a
    roof falls by at most half of the height.
    """
    cos, sin = math.cos(house.turn_rad), math.sin(house.turn_rad)
    along, across = np.abs(at_m[:, 0] * cos + at_m[:, 1] * sin), np.abs(at_m[:, 1] * cos - at_m[:, 0] * sin)
    width, depth, height = house.size_m
    eaves = 0.1 * min(width, depth)
    below_roof = at_m[:, 2] < height * (1.0 - across / depth) - _ROOF_M
    return np.asarray((along < 0.5 * width - eaves) & (across < 0.5 * depth - eaves) & (at_m[:, 2] > 0) & below_roof)


def check_outside_of_houses(drawn: DrawnRecipe, obstacles: Sequence[Obstacle]) -> list[str]:
    """Refuse cameras inside of houses, which see dark walls; notes on those of entries whose `obstructed` is a note.

    Raises
    ------
    RecipeError : with the camera's line.
    """
    notes = []
    for index, camera, number in in_houses(drawn, obstacles):
        house = obstacles[number]
        problem = f"the camera {camera.name} stands inside of a {house.species}"
        expected = f"a place outside of community.obstacles.{number}, at [{_numbers(house.position_m)}]"
        hint = "move it; or set obstructed: note, to look at it all the same"
        notes.append(_note_or_error(drawn, index, camera, problem, expected, hint))
    return notes


def _note_or_error(drawn: DrawnRecipe, index: int, camera: Camera, problem: str, expected: str, hint: str) -> str:
    """The problem as a note, where the camera's entry lets it be one; else a `RecipeError`."""
    section = drawn.recipe.cameras[index]
    if section.obstructed == "note":
        return problem
    where, got = drawn.where("cameras", index, *_place_key(section)), f"[{_numbers(camera.position_m)}]"
    raise RecipeError(problem, where=where, expected=expected, got=got, hint=hint)


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def _place_key(section: CameraSection) -> tuple[str, ...]:
    """The key that says where a camera is."""
    if section.position_m is None:
        return ("rig",)
    return ("path", "position_m") if section.path is not None and section.path.position_m else ("position_m",)


def check_trunks(drawn: DrawnRecipe, cameras: Sequence[Sequence[Camera]], trunks: Trunks) -> list[str]:
    """Refuse cameras in trunks or right before them; notes on those of entries whose `obstructed` is a note.

    Raises
    ------
    RecipeError : with the camera's line.
    """
    notes = []
    for index, entry in enumerate(cameras):
        for camera in entry:
            apart_m, plant = trunks.clearance_m(np.array(camera.position_m), LEAST_FROM_TRUNKS_M)
            if not plant:
                continue
            stands = "in" if apart_m < 0 else f"{apart_m * 100:.2g} cm from"
            problem = f"the camera {camera.name} stands {stands} the trunk of plant {plant}"
            expected = f"at least {LEAST_FROM_TRUNKS_M * 100:g} cm to any trunk"
            hint = "move it; rig: {kind: walk} goes around trunks; or set obstructed: note"
            notes.append(_note_or_error(drawn, index, camera, problem, expected, hint))
    return notes
