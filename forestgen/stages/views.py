"""Cameras of a drawn recipe, and whether something is in their way: told before any image is rendered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forestgen.core.errors import RecipeError
from forestgen.core.spectrum import Band
from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.cameras import SensorFile
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.spectra import bands_of, load_bands
from forestgen.scene.camera_path import expand
from forestgen.scene.spec import Camera
from forestgen.scene.trunks import Trunks
from forestgen.stages.ground import height_field

LEAST_ABOVE_GROUND_M = 0.01
LEAST_FROM_TRUNKS_M = 0.05


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
    for index, (section, entry) in enumerate(zip(drawn.recipe.cameras, cameras, strict=True)):
        for camera in entry:
            apart_m, plant = trunks.clearance_m(np.array(camera.position_m), LEAST_FROM_TRUNKS_M)
            if not plant:
                continue
            stands = "in" if apart_m < 0 else f"{apart_m * 100:.2g} cm from"
            problem = f"the camera {camera.name} stands {stands} the trunk of plant {plant}"
            if section.obstructed == "note":
                notes.append(problem)
                continue
            raise RecipeError(
                problem,
                where=drawn.where("cameras", index, *_place_key(section)),
                expected=f"at least {LEAST_FROM_TRUNKS_M * 100:g} cm to any trunk",
                got="[" + ", ".join(f"{value:.2f}" for value in camera.position_m) + "]",
                hint="move it; rig: {kind: walk} goes around trunks; or set obstructed: note",
            )
    return notes
