"""Cameras of a recipe, and what is wrong with them, one by one and together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Self

from pydantic import model_validator
from pydantic_core import PydanticCustomError

from forestgen.recipe.camera_keys import CameraKeys
from forestgen.recipe.fields import mistake
from forestgen.recipe.rigs import MOST_FRAMES, DroneGrid, Orbit, Stereo

_WIDEST_DEG = 170.0  # of a perspective camera
_KEYS_OF_KINDS: dict[str, tuple[str, ...]] = {
    "perspective": ("hfov_deg", "focal_length_mm", "sensor_width_mm", "f_number", "focus_m"),
    "fisheye": ("hfov_deg",),
    "orthographic": ("width_m",),
    "panorama": (),
}
_ALL_KEYS = tuple(dict.fromkeys(key for keys in _KEYS_OF_KINDS.values() for key in keys))
_AN = {"orthographic": "an orthographic", "orbit": "an orbit"}
# What a rig decides itself.
_NOT_WITH_RIG: dict[str, tuple[str, ...]] = {
    "stereo": (),
    "orbit": ("position_m", "look", "path"),
    "walk": ("position_m", "path"),
    "drone_grid": ("position_m", "look_at_m", "look", "path"),
}


class Camera(CameraKeys):
    """A camera; site frame: x east, y north, z up, metres."""

    @model_validator(mode="after")
    def _is_one_camera(self) -> Self:
        wrong = wrong_with(self)
        if wrong is not None:
            raise wrong
        return self


def wrong_with(camera: CameraKeys) -> PydanticCustomError | None:
    """The first mistake in one camera, for its validator to raise."""
    return _kind(camera) or _optics(camera) or _rigged(camera) or _looking(camera) or _looks_at_itself(camera)


def _kind(camera: CameraKeys) -> PydanticCustomError | None:
    """A key that the camera's kind does not have."""
    mine = _KEYS_OF_KINDS[camera.kind]
    for key in _ALL_KEYS:
        if getattr(camera, key) is not None and key not in mine:
            kinds = [kind for kind, keys in _KEYS_OF_KINDS.items() if key in keys]
            return mistake(
                f"of these keys: {', '.join(mine)}" if mine else f"none of {', '.join(_ALL_KEYS)}",
                problem=f"{_AN.get(camera.kind, 'a ' + camera.kind)} camera has no {key}",
                got=f"{getattr(camera, key):g}",
                hint=f"leave {key} out, or choose kind: {' or '.join(kinds)}",
                at=(key,),
            )
    return None


def _optics(camera: CameraKeys) -> PydanticCustomError | None:
    """What is wrong with a kind's own keys."""
    if camera.kind == "orthographic" and camera.width_m is None:
        return mistake(
            "the width of what the image shows, metres",
            problem="an orthographic camera needs width_m",
            got="no width_m",
            at=("width_m",),
        )
    if camera.kind == "panorama" and camera.size_px[0] != 2 * camera.size_px[1]:
        width, height = camera.size_px
        return mistake(
            "twice as many pixels across as down: 360 by 180 degrees",
            problem="a panorama's image is 2:1",
            got=f"[{width}, {height}]",
            hint=f"size_px: [{2 * height}, {height}]",
            at=("size_px",),
        )
    if camera.kind != "perspective":
        return None
    if camera.hfov_deg is not None and camera.focal_length_mm is not None:
        other = math.degrees(2 * math.atan(camera.sensor_mm / 2 / camera.focal_length_mm))
        return mistake(
            "hfov_deg or focal_length_mm, not both",
            problem="the field of view is given twice",
            got=f"hfov_deg {camera.hfov_deg:g}; {camera.focal_length_mm:g} mm are {other:.4g} degrees",
            hint="leave hfov_deg out",
            at=("focal_length_mm",),
        )
    if camera.field_of_view_deg > _WIDEST_DEG:
        return mistake(
            f"at most {_WIDEST_DEG:g} degrees",
            problem="too wide for a flat image",
            got=f"{camera.field_of_view_deg:.4g} degrees",
            hint="kind: fisheye sees further around",
            at=("hfov_deg" if camera.hfov_deg is not None else "focal_length_mm",),
        )
    return _lens(camera)


def _lens(camera: CameraKeys) -> PydanticCustomError | None:
    if (camera.f_number is None) != (camera.focus_m is None):
        has, lacks = ("f_number", "focus_m") if camera.focus_m is None else ("focus_m", "f_number")
        return mistake(
            "both, or neither for a pinhole, which is sharp everywhere",
            problem=f"a lens with {has} needs {lacks} too",
            got=f"no {lacks}",
            hint="exposure.f_number makes a picture brighter and blurs nothing" if lacks == "focus_m" else None,
            at=(has,),
        )
    lens = camera.lens_mm
    if lens is not None and camera.focus_m is not None and camera.focus_m * 1000 <= lens[1]:
        return mistake(
            f"more than its focal length, {lens[1]:.4g} mm",
            problem="no lens focuses so near",
            got=f"{camera.focus_m:g} m",
            at=("focus_m",),
        )
    if camera.f_number is not None and camera.exposure is not None and camera.exposure.f_number != camera.f_number:
        return mistake(
            f"the lens' own f_number, {camera.f_number:g}, or none in the exposure",
            problem="one lens has two f-numbers",
            got=f"{camera.exposure.f_number:g}",
            at=("exposure", "f_number"),
        )
    return None


def _rigged(camera: CameraKeys) -> PydanticCustomError | None:
    """What is wrong with a rig beside the camera's other keys."""
    if camera.rig is None:
        missing = [key for key in ("position_m", "look_at_m") if getattr(camera, key) is None]
        if camera.look is not None:
            missing = [key for key in missing if key != "look_at_m"]
        if missing:
            return mistake(
                "x, y, z in metres", problem=f"the key {missing[0]!r} is missing", got="nothing", at=(missing[0],)
            )
        return None
    rig = camera.rig.kind
    for key in _NOT_WITH_RIG[rig]:
        if getattr(camera, key) is not None:
            return mistake(
                "no such key beside this rig",
                problem=f"{_AN.get(rig, 'a ' + rig)} says itself where the camera {'looks' if 'look' in key else 'is'}",
                got=key,
                hint=f"leave {key} out",
                at=(key,),
            )
    if isinstance(camera.rig, Orbit) and camera.look_at_m is None:
        return mistake("the circle's middle", problem="an orbit needs look_at_m", got="no look_at_m", at=("rig",))
    if isinstance(camera.rig, DroneGrid) and camera.kind not in ("perspective", "orthographic"):
        return mistake("perspective or orthographic", problem="no camera for a grid", got=camera.kind, at=("kind",))
    if isinstance(camera.rig, DroneGrid) and camera.rig.area_m is None:
        return mistake("two corners", problem="the grid needs an area_m", got="none", at=("rig",))
    return None


def _looking(camera: CameraKeys) -> PydanticCustomError | None:
    if camera.look is None:
        return None
    if camera.look_at_m is not None or (camera.path is not None and camera.path.look_at_m):
        at = ("look_at_m",) if camera.look_at_m is not None else ("path", "look_at_m")
        return mistake("look or look_at_m, not both", problem="two ways to look", got=f"look: {camera.look}", at=at)
    if camera.kind == "panorama" and camera.look in ("up", "down"):
        return mistake(
            "north, east, south or west: what is in the image's middle",
            problem="a panorama is level",
            got=camera.look,
            at=("look",),
        )
    return None


def _looks_at_itself(camera: CameraKeys) -> PydanticCustomError | None:
    if camera.look is not None or not isinstance(camera.rig, Stereo | None):
        return None
    # Heights above ground do not matter: a point above another has the same ground.
    flat = 2 if camera.kind == "panorama" else 3  # a panorama is level: only the direction on the map counts
    for index, (position, look_at) in enumerate(zip(camera.positions_m, camera.looks_at_m, strict=True)):
        if math.dist(position[:flat], look_at[:flat]) < 1e-6:
            start = camera.path is None or index == 0
            at: tuple[str, ...] = ("look_at_m",) if start else ("path",)
            if not start and camera.path is not None:
                at += ("look_at_m",) if camera.path.look_at_m else ("position_m",)
            return mistake(
                "a look_at_m away from position_m" + ("" if start else " all the way"),
                problem="the camera looks at itself" + ("" if start else f" in frame {index} of its path"),
                got=str([round(x, 6) for x in look_at]),
                at=at,
            )
    return None


def check_cameras(cameras: Sequence[Camera]) -> None:
    """Raise a recipe's mistake if names of images collide or there are too many of them."""
    frames = 0
    owner: dict[str, int] = {}
    for index, camera in enumerate(cameras):
        frames += camera.frames
        if frames > MOST_FRAMES:
            raise mistake(
                f"at most {MOST_FRAMES} frames of all cameras together",
                problem="too many frames",
                got=f"{sum(one.frames for one in cameras)}",
                at=(index, "path", "frames") if camera.path else (index, "rig") if camera.rig else (index,),
            )
        for name in {camera.name: None, **dict.fromkeys(camera.frame_names)}:
            # Compared without case: the names become files, and some file systems ignore case.
            first = owner.setdefault(name.lower(), index)
            if first != index:
                raise _collision(cameras, first, index, name)


def check_motion(cameras: Sequence[Camera], *, plants_move: bool) -> None:
    """Raise a recipe's mistake if a path makes one image over and over again."""
    for index, camera in enumerate(cameras):
        if camera.path is not None and not camera.moves and not plants_move:
            raise mistake(
                "points in position_m or look_at_m that differ from the camera's own, or gusty wind",
                problem="nothing moves along this path: all of its images would be the same",
                got=f"{camera.frames} frames",
                hint="add path.position_m, set wind.speed_m_per_s and wind.gustiness, or leave the path out",
                at=("cameras", index, "path"),
            )


def _collision(cameras: Sequence[Camera], first: int, second: int, name: str) -> PydanticCustomError:
    if cameras[first].name.lower() == cameras[second].name.lower():
        return mistake(
            "a different name for each camera",
            problem="two cameras of one name",
            got=cameras[second].name,
            at=(second, "name"),
        )
    other = cameras[first].name
    return mistake(
        "other names than those of a path's frames, NAME-0000, NAME-0001, ...",
        problem=f"two images of one name, {name}",
        got=f"{cameras[second].name}, beside the camera {other}",
        at=(second, "name"),
    )
