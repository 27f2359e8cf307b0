"""Cameras of a recipe, and what is wrong with them, one by one and together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, GetJsonSchemaHandler, SerializeAsAny, model_validator
from pydantic_core import PydanticCustomError

from forestgen.recipe.camera_keys import CameraKeys
from forestgen.recipe.fields import violation
from forestgen.recipe.registries import DEFAULT_PROJECTION, PROJECTIONS
from forestgen.recipe.rigs import MOST_FRAMES


class Camera(CameraKeys):
    """A camera; site frame: x east, y north, z up, metres. Each projection has a subclass with its own keys."""

    @model_validator(mode="before")
    @classmethod
    def _has_no_keys_of_others(cls, data: Any) -> Any:
        """Keys of other projections are refused by name; keys that are null are ignored."""
        strange = [key for key in data if key not in cls.model_fields] if isinstance(data, Mapping) else []
        owners = _owners_of_keys() if strange else {}
        kind = data.get("kind", DEFAULT_PROJECTION) if strange else ""
        for key in strange:
            if cls is not Camera and key in owners and data[key] is not None:
                mine = cls.own_keys()
                expected = f"of these keys: {', '.join(mine)}" if mine else f"none of {', '.join(owners)}"
                problem, hint = f"{_article(kind)} camera has no {key}", f"choose kind: {' or '.join(owners[key])}"
                raise violation(
                    expected, problem=problem, got=str(data[key]), hint=f"leave {key} out, or {hint}", at=key
                )
        unsaid = {key for key in strange if key in owners}
        unsaid |= {key for key in cls.own_keys() if isinstance(data, Mapping) and data.get(key, 0) is None}
        return {key: value for key, value in data.items() if key not in unsaid} if unsaid else data

    @model_validator(mode="after")
    def _is_one_camera(self) -> Self:
        wrong = self.wrong_optics() or _rigged(self) or _looking(self) or _looks_at_itself(self)
        if wrong is not None:
            raise wrong
        return self

    def wrong_optics(self) -> PydanticCustomError | None:
        """What is wrong with the projection's own keys, or with the image's size for it."""
        return None

    @classmethod
    def own_keys(cls) -> list[str]:
        """Names of the keys that cameras of other projections do not all have."""
        return [key for key in cls.model_fields if key not in CameraKeys.model_fields]

    @classmethod
    def class_for(cls, data: object) -> type[Camera]:
        """The class of cameras like `data`; this one where its projection is none."""
        kind = data.get("kind", DEFAULT_PROJECTION) if isinstance(data, Mapping) else None
        return class_of(kind) if isinstance(kind, str) and kind in PROJECTIONS else Camera

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Of all projections' cameras together, with all of their keys."""
        made = handler.resolve_ref_schema(handler(core_schema))
        if cls is Camera:
            for _, part in PROJECTIONS.parts():
                own = part.Parameters
                properties = own.model_json_schema()["properties"]
                made["properties"] |= {key: properties[key] for key in own.own_keys() if key not in made["properties"]}
        return made


def class_of(kind: str) -> type[Camera]:
    """The class of a projection's cameras."""
    found: type[Camera] = PROJECTIONS.load(kind).Parameters
    return found


def camera_section(data: Mapping[str, Any]) -> Camera:
    """A recipe's camera from its keys, of the class of its projection."""
    return Camera.class_for(data).model_validate(data)


def _of_its_class(data: Any) -> Any:
    return camera_section(data) if isinstance(data, Mapping) else data  # validation reports what is no mapping


AnyCamera = Annotated[SerializeAsAny[Camera], BeforeValidator(_of_its_class)]


def _owners_of_keys() -> dict[str, list[str]]:
    """Key -> the projections whose cameras have it."""
    owners: dict[str, list[str]] = {}
    for name, part in PROJECTIONS.parts():
        for key in part.Parameters.own_keys():
            owners.setdefault(key, []).append(name)
    return owners


def _article(noun: str) -> str:
    return f"{'an' if noun[:1] in 'aeiou' else 'a'} {noun}"


def _rigged(camera: CameraKeys) -> PydanticCustomError | None:
    """What is wrong with a rig beside the camera's other keys."""
    if camera.rig is None:
        needed = ("position_m", "look_at_m") if camera.look is None else ("position_m",)
        missing = next((key for key in needed if getattr(camera, key) is None), None)
        if missing is None:
            return None
        return violation("x, y, z in metres", problem=f"the key {missing!r} is missing", got="nothing", at=missing)
    rig, part = camera.rig.kind, camera.rig_part
    for key in part.decides:
        if getattr(camera, key) is not None:
            problem = f"{_article(rig)} says itself where the camera {'looks' if 'look' in key else 'is'}"
            return violation("no such key beside this rig", problem=problem, got=key, hint=f"leave {key} out", at=key)
    wrong: PydanticCustomError | None = part.check(camera)
    return wrong


def _looking(camera: CameraKeys) -> PydanticCustomError | None:
    if camera.look is None:
        return None
    if camera.look_at_m is not None or (camera.path is not None and camera.path.look_at_m):
        at = ("look_at_m",) if camera.look_at_m is not None else ("path", "look_at_m")
        return violation("look or look_at_m, not both", problem="two ways to look", got=f"look: {camera.look}", at=at)
    if camera.is_level and camera.look in ("up", "down"):
        expected = "north, east, south or west: what is in the image's middle"
        return violation(expected, problem=f"{_article(camera.kind)} is level", got=camera.look, at="look")
    return None


def _looks_at_itself(camera: CameraKeys) -> PydanticCustomError | None:
    if camera.look is not None or not (camera.rig is None or camera.rig_part.keeps_view):
        return None
    # Heights above ground do not matter: a point above another has the same ground.
    flat = 2 if camera.is_level else 3  # of a level one only the direction on the map counts
    for index, (position, look_at) in enumerate(zip(camera.positions_m, camera.looks_at_m, strict=True)):
        if math.dist(position[:flat], look_at[:flat]) < 1e-6:
            got = str([round(x, 6) for x in look_at])
            if camera.path is None or index == 0:
                expected, problem = "a look_at_m away from position_m", "the camera looks at itself"
                return violation(expected, problem=problem, got=got, at="look_at_m")
            expected, problem = "a look_at_m away from position_m all the way", "the camera looks at itself in frame"
            at = ("path", "look_at_m" if camera.path.look_at_m else "position_m")
            return violation(expected, problem=f"{problem} {index} of its path", got=got, at=at)
    return None


def check_cameras(cameras: Sequence[Camera]) -> None:
    """Raise an error of validation if names of images collide or there are too many of them."""
    frames = 0
    owner: dict[str, int] = {}
    for index, camera in enumerate(cameras):
        frames += camera.frames
        if frames > MOST_FRAMES:
            at = (index, "path", "frames") if camera.path else (index, "rig") if camera.rig else (index,)
            expected, got = f"at most {MOST_FRAMES} frames of all cameras together", sum(one.frames for one in cameras)
            raise violation(expected, problem="too many frames", got=str(got), at=at)
        for name in {camera.name: None, **dict.fromkeys(camera.frame_names)}:
            # Compared without case: the names become files, and some file systems ignore case.
            first = owner.setdefault(name.lower(), index)
            if first != index:
                raise _collision(cameras, first, index, name)


def check_motion(cameras: Sequence[Camera], *, plants_move: bool) -> None:
    """Raise an error of validation if all images of a path would be the same."""
    for index, camera in enumerate(cameras):
        if camera.path is not None and not camera.moves and not plants_move:
            raise violation(
                "points in position_m or look_at_m that differ from the camera's own, or gusty wind",
                problem="nothing moves along this path: all of its images would be the same",
                got=f"{camera.frames} frames",
                hint="add path.position_m, set wind.speed_m_per_s and wind.gustiness, or leave the path out",
                at=("cameras", index, "path"),
            )


def _collision(cameras: Sequence[Camera], first: int, second: int, name: str) -> PydanticCustomError:
    one, other, at = cameras[first].name, cameras[second].name, (second, "name")
    if one.lower() == other.lower():
        return violation("a different name for each camera", problem="two cameras of one name", got=other, at=at)
    expected = "other names than those of a path's frames, NAME-0000, NAME-0001, ..."
    return violation(
        expected, problem=f"two images of one name, {name}", got=f"{other}, beside the camera {one}", at=at
    )
