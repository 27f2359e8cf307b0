"""The cameras of a drawn recipe, and whether something is in their way: reported before any image is rendered."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.core.frames import look_at
from forestgen.core.spectrum import Band
from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.cameras import SensorFile
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.species import Building
from forestgen.recipe.spectra import bands_of, load_bands
from forestgen.scene.motion import with_their_ways
from forestgen.scene.projection import check_projection
from forestgen.scene.rigs.rig import Poses, path_poses
from forestgen.scene.site import height_field
from forestgen.scene.spec import Camera, CameraMotion, Lens
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import Trunks
from forestgen.scene.weather.kind import raised_m

Floats = NDArray[np.float64]

LEAST_ABOVE_GROUND_M = 0.01
LEAST_FROM_TRUNKS_M = 0.05
NO_BANDS: Mapping[SensorFile, tuple[Band, ...]] = {}
_ROOF_M = 0.5  # its thickness, and more: a camera on the roof is outside


def drawn_cameras(drawn: DrawnRecipe, trunks: Trunks | None = None) -> list[list[Camera]]:
    """The cameras of each entry; walks go straight where no trunks are given.

    Raises `RecipeError, AssetError`: bands that no file has, or a walk without a way, with its line.
    """
    bands = _bands(drawn)
    cameras = []
    for index, section in enumerate(drawn.recipe.cameras):
        try:
            cameras.append(expand(section, height_field(drawn), trunks, bands))
        except RecipeError as cause:  # the scene knows keys only
            keys = [int(key) if key.isdigit() else key for key in (cause.where or "").split(".")]
            raise cause.at(drawn.where("cameras", index, *keys)) from cause
    return cameras


def _bands(drawn: DrawnRecipe) -> dict[SensorFile, tuple[Band, ...]]:
    bands = {}
    for index, section in enumerate(drawn.recipe.cameras):
        if section.bands is not None:
            name, text, where = section.bands.name, section.bands.text, drawn.where("cameras", index, "bands")
            found = load_bands(name, folder=drawn.folder, where=where) if text is None else bands_of(text, name, where)
            bands[section.bands] = found
    return bands


@dataclass(frozen=True)
class Views:
    """The cameras of a drawn recipe above its ground; by `of`, walks go straight, for no trunks are known yet."""

    drawn: DrawnRecipe
    height: HeightField
    cameras: list[list[Camera]]  # of each entry
    laid_m: Callable[[Floats], Floats] | None = None  # by how much weather raises the ground; None: plants are unknown

    @classmethod
    def of(cls, drawn: DrawnRecipe) -> Views:
        """Raises `RecipeError` or `AssetError` as `drawn_cameras` and `height_field` do."""
        return cls(drawn, height_field(drawn), drawn_cameras(drawn))

    @property
    def all_cameras(self) -> list[Camera]:
        return [camera for entry in self.cameras for camera in entry]

    @property
    def lowest_m(self) -> float:
        """Height of the site's lowest ground, where weather begins."""
        x, y = np.meshgrid(*(np.linspace(0.0, side, 65) for side in self.drawn.recipe.site.size_m))
        return float(np.min(self.height(x, y)))

    def ground_below(self, camera: Camera) -> float:
        """Height of the ground below a camera, metres, world."""
        x, y, _ = camera.position_m
        return float(self.height(np.array([x]), np.array([y]))[0])

    @property
    def below_ground(self) -> dict[str, str]:
        """By name, below what cameras, or frames of a path, stand that stand below the ground or snow and may."""
        return {camera.name: self._lowest(camera) for _, camera, _ in self._below_ground()}

    def _lowest(self, camera: Camera) -> str:
        x, y, z = camera.position_m
        if z - self.ground_below(camera) < LEAST_ABOVE_GROUND_M:
            return "the ground"
        in_water = z < self.height.level(np.array([x]), np.array([y]))[0] + LEAST_ABOVE_GROUND_M
        return "the water" if in_water else "the snow"

    def _below_ground(self) -> list[tuple[int, Camera, float]]:
        """Number of the entry, camera and height above the ground, or its snow, of cameras that are not above it, those
        that move at any time of their exposure.
        """
        found = []
        for index, entry in enumerate(self.cameras):
            cameras = with_their_ways(entry)
            at_m = np.array([camera.position_m for camera in cameras], dtype=np.float64)
            is_dry = self.height.level(*at_m[:, :2].T) <= self.height(*at_m[:, :2].T)  # no snow lies on water
            laid = raised_m(self.drawn, at_m[:, :2]) if self.laid_m is None else self.laid_m(at_m[:, :2])
            deep = np.where(is_dry, laid, 0.0)
            above = at_m[:, 2] - self.height.surface(*at_m[:, :2].T) - deep
            found += [(index, cameras[k], float(above[k])) for k in np.flatnonzero(above < LEAST_ABOVE_GROUND_M)]
        return found

    def check_above_ground(self) -> list[str]:
        """Notes on cameras below the ground or its snow, of entries whose `obstructed` is a note.

        Raises `RecipeError`: a camera of another entry, with its line.
        """
        notes = []
        for index, camera, above_m in self._below_ground():
            surface, way_out = self._lowest(camera), "raise it"
            problem = f"the camera {camera.name} stands below {surface}"
            expected = f"at least {LEAST_ABOVE_GROUND_M * 100:g} cm above {surface}"
            notes.append(_note_or_error(self.drawn, index, problem, expected, f"{above_m:.3g} m", way_out))
        return notes

    def check_outside_of_buildings(self) -> list[str]:
        """Notes on cameras inside of buildings, which see dark walls, of entries whose `obstructed` is a note.

        Raises `RecipeError`: a camera of another entry, with its line.
        """
        buildings = self.drawn.recipe.site.buildings
        if not buildings:
            return []
        feet = np.array([one.position_m for one in buildings])
        ground_m, notes = self.height(feet[:, 0], feet[:, 1]), []
        for index, cameras in enumerate(self.cameras):
            at_m = np.array([camera.position_m for camera in cameras])
            for number, building in enumerate(buildings):
                inside = _is_within(building, at_m - [*building.position_m, float(ground_m[number])])
                for camera in (cameras[k] for k in np.flatnonzero(inside)):
                    place = f"site.buildings.{number}, at [{_numbers(building.position_m)}]"
                    problem, got = f"the camera {camera.name} stands inside of a {building.kind}", camera.position_m
                    expected = f"a place outside of {place}"
                    notes.append(_note_or_error(self.drawn, index, problem, expected, f"[{_numbers(got)}]", "move it"))
        return notes


def _is_within(building: Building, at_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) whether points lie inside, (N, 3) metres from the middle of the ground plan; walls, eaves left out.

    That is what `scene.building.BuildingKind` says of walls and roofs.
    """
    cos, sin = math.cos(building.turn_rad), math.sin(building.turn_rad)
    along, across = np.abs(at_m[:, 0] * cos + at_m[:, 1] * sin), np.abs(at_m[:, 1] * cos - at_m[:, 0] * sin)
    width, depth, height = building.size_m
    eaves = 0.1 * min(width, depth)
    below_roof = at_m[:, 2] < height * (1.0 - across / depth) - _ROOF_M
    return np.asarray((along < 0.5 * width - eaves) & (across < 0.5 * depth - eaves) & (at_m[:, 2] > 0) & below_roof)


def check_trunks(drawn: DrawnRecipe, cameras: Sequence[Sequence[Camera]], trunks: Trunks) -> list[str]:
    """Notes on cameras in trunks or right before them, of entries whose `obstructed` is a note.

    Raises `RecipeError`: a camera of another entry, with its line.
    """
    notes = []
    for index, entry in enumerate(cameras):
        for camera in entry:
            apart_m, plant = trunks.clearance_m(np.array(camera.position_m), LEAST_FROM_TRUNKS_M)
            if plant:
                stands = "in" if apart_m < 0 else f"{apart_m * 100:.2g} cm from"
                problem = f"the camera {camera.name} stands {stands} the trunk of plant {plant}"
                expected, got = f"at least {LEAST_FROM_TRUNKS_M * 100:g} cm to any trunk", _numbers(camera.position_m)
                way_out = "move it; rig: {kind: walk} goes around trunks"
                notes.append(_note_or_error(drawn, index, problem, expected, f"[{got}]", way_out))
    return notes


def _note_or_error(drawn: DrawnRecipe, index: int, problem: str, expected: str, got: str, way_out: str) -> str:
    """The problem as a note, where the entry of cameras lets it be one; else a `RecipeError` at the camera's place."""
    section = drawn.recipe.cameras[index]
    if section.obstructed == "note":
        return problem
    where = drawn.where("cameras", index, *place_key(section))
    hint = f"{way_out}; or set obstructed: note, to look at it all the same"
    raise RecipeError(problem, where=where, expected=expected, got=got, hint=hint)


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def place_key(section: CameraSection, *, path: bool = True) -> tuple[str, ...]:
    """The key that says where a camera is; `path`: of its path, where that has places."""
    if section.position_m is None:
        return ("rig",)
    on_path = path and section.path is not None and section.path.position_m
    return ("path", "position_m") if on_path else ("position_m",)


def expand(
    section: CameraSection,
    height: HeightField,
    trunks: Trunks | None = None,
    bands: Mapping[SensorFile, tuple[Band, ...]] = NO_BANDS,
) -> list[Camera]:
    """A recipe's camera in the world: one, or one a frame of its path or rig.

    Points of a path are counted as the camera's own: where z is a height above ground, each frame's position and
    look-at point are lifted by the ground under them, so that a camera walks over a hill and not through it.

    `trunks`: that walks go around; without them they go straight. `bands`: of the sensors that cameras name.
    """
    rig = section.rig_part
    poses: Poses = path_poses(section, height) if rig is None else rig.poses(section, height, trunks)
    lens, focus_m = section.lens_mm, section.lens_focus_m
    cameras = []
    for index, name in enumerate(section.frame_names):
        position, target = poses.position_m[index], poses.target_m[index]
        aim = np.array([target[0], target[1], position[2]]) if section.is_level else target
        axes = look_at(position.tolist(), aim.tolist())
        if poses.right_m is not None:
            position = position + poses.right_m[index] * axes[:, 0]
        x, y, z = (float(value) for value in position)
        cameras.append(
            Camera(
                name=name,
                position_m=(x, y, z),
                world_from_camera=axes,
                size_px=section.size_px,
                hfov_deg=section.field_of_view_deg,
                sequence=_sequence(section, index),
                time_s=float(poses.time_s[index]),
                projection=section.kind,
                width_m=section.view_width_m,
                lens=None if lens is None or focus_m is None else Lens(lens[0] / 1000, focus_m),
                bands=() if section.bands is None else bands.get(section.bands, ()),
                exposure=section.exposure,
                numbers=section.own_numbers,
                motion=_motion(section),
            )
        )
    check_projection(cameras[0])
    return cameras


def _motion(section: CameraSection) -> CameraMotion | None:
    keys = section.motion
    if keys is None or not keys.moves:
        return None
    pitch, yaw, roll = (math.radians(one) for one in keys.rotation_deg_per_s)
    return CameraMotion(keys.velocity_m_per_s, (pitch, yaw, roll), keys.readout_s)


def _sequence(section: CameraSection, index: int) -> str | None:
    """Name of the images that follow each other in time; None for stills."""
    if section.rig is None:
        return None if section.path is None else section.name
    named: str | None = section.rig_part.sequence(section, index)
    return named


def next_frame(cameras: Sequence[Camera], camera: Camera) -> Camera | None:
    """The frame that follows `camera` in its sequence; None for a still camera and for a sequence's last frame."""
    if camera.sequence is None:
        return None
    frames = [one for one in cameras if one.sequence == camera.sequence]
    names = [one.name for one in frames]
    after = names.index(camera.name) + 1
    return frames[after] if after < len(frames) else None
