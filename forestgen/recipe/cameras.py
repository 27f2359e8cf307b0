"""Cameras of a recipe, what follows from their keys, and what is wrong with them, one by one and together.

A camera with a path is as many images as the path has frames. Times run in equal steps over the whole path; each of
the two lists of points is a polyline of its own over that time, every piece of it as long in time as the next.
A camera with a rig (scene/rigs) is several images, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, SerializeAsAny, model_validator
from pydantic_core import PydanticCustomError

from forestgen.recipe.exposure import Exposure
from forestgen.recipe.fields import (
    Coordinate,
    Flag,
    Name,
    Number,
    PartSection,
    Point,
    Section,
    Text,
    Whole,
    shorthand,
    violation,
)  # fmt: skip
from forestgen.recipe.registries import DEFAULT_PROJECTION, PROJECTIONS, RIGS
from forestgen.recipe.spectra import MOST_BYTES

MOST_FRAMES = 1000  # of all cameras together
GroundPoint = tuple[Coordinate, Coordinate]
Speed = Annotated[Number, Field(ge=-1000, le=1000)]
Turn = Annotated[Number, Field(ge=-3600, le=3600)]
FramesPerSecond = Annotated[Number, Field(ge=0.001, le=1000)]

Pixels = Annotated[Whole, Field(ge=8, le=16384)]
Look = Literal["up", "down", "north", "east", "south", "west"]
DIRECTIONS: dict[str, Point] = {  # right, down and forward follow: see core/frames.py
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
    "north": (0.0, 1.0, 0.0),
    "east": (1.0, 0.0, 0.0),
    "south": (0.0, -1.0, 0.0),
    "west": (-1.0, 0.0, 0.0),
}


class SensorFile(Section):
    """A table of the responses of a sensor's bands by wavelength; see recipe/spectra.py."""

    name: Text = Field(min_length=1, max_length=1000, description="Such as sentinel2a, or a path.")
    text: Text | None = Field(
        None, max_length=MOST_BYTES, description="The table itself, as drawn recipes keep a file of your own."
    )


class CameraPath(Section):
    """A camera's way from where it stands, through points, in equal times; straight lines between them."""

    frames: Whole = Field(ge=2, le=MOST_FRAMES, description="Images along the way, both ends included.")
    frames_per_s: FramesPerSecond = Field(24.0, description="Images a second: of motion and wind.")
    position_m: tuple[Point, ...] = Field(
        (), max_length=1000, description="Points it passes after position_m: x, y, z, metres."
    )
    look_at_m: tuple[Point, ...] = Field(
        (), max_length=1000, description="Points in the image's middle after look_at_m, metres."
    )


class CameraMotion(Section):
    """How a camera moves while its shutter is open; see scene/motion.py. It needs an exposure, which has the time."""

    velocity_m_per_s: tuple[Speed, Speed, Speed] = Field(
        (0.0, 0.0, 0.0), description="x east, y north, z up, metres a second."
    )
    rotation_deg_per_s: tuple[Turn, Turn, Turn] = Field(
        (0.0, 0.0, 0.0),
        description="About the camera's own right, down and forward: positive ones turn it up, to the right, and "
        "clockwise.",
    )
    readout_s: Number = Field(
        0.0, ge=0, le=10, description="Of a rolling shutter, which exposes row after row: for all rows. 0: all at once."
    )

    @property
    def moves(self) -> bool:
        return any((*self.velocity_m_per_s, *self.rotation_deg_per_s))


class RigKeys(PartSection):
    """Several images of one entry of a recipe's cameras. How many follows from the recipe alone."""

    registry = RIGS
    selector = "kind"

    kind: Annotated[Text, Field(description="The rig.")]


class Camera(PartSection):
    """A camera; site frame: x east, y north, z up, metres. Each projection has a subclass with its own keys."""

    registry = PROJECTIONS
    selector = "kind"

    default_size_px: ClassVar[tuple[int, int]] = (640, 360)
    default_look: ClassVar[Look | None] = None  # None: over the site, by look_at_m
    default_place: ClassVar[Point] = (0.5, 0.02, 1.7)  # shares of the site's width and depth, and metres above ground
    is_level: ClassVar[bool] = False  # whatever it looks at
    has_lens: ClassVar[bool] = False  # one that may show ghosts of the sun: `focal_px` is its focal length
    covers_ground: ClassVar[bool] = False  # whether `footprint_m` is known, as drone_grid needs

    name: Name = Field(description="Name in file names; default camera0, camera1, ...")
    kind: Text = Field(
        DEFAULT_PROJECTION,
        description="Projection, of those that `forestgen models --kind projection` lists; its page has its keys, and "
        "its defaults of position_m, look and size_px.",
    )
    position_m: Point | None = Field(
        None,
        description="Where it stands: x, y, z, metres. Default by kind; of perspective eye level, southern edge's "
        "middle.",
    )
    look_at_m: Point | None = Field(
        None, description="The point in the image's middle: x, y, z, metres. Default: amid the site."
    )
    look: Look | None = Field(
        None,
        description="Instead of look_at_m. Up and down have north at the top: down shows east on the right, up shows "
        "it on the left. Default by kind; of perspective look_at_m.",
    )
    size_px: tuple[Pixels, Pixels] = Field(
        (640, 360), description="Width and height of the image, pixels. Default by kind; of perspective [640, 360]."
    )
    height_above_ground: Flag = Field(
        True, description="Whether the z of position_m and look_at_m count from the ground below or from z = 0."
    )
    obstructed: Literal["error", "note"] = Field(
        "error",
        description="How a camera below the ground, in a house or in a trunk is treated. error: reported before it is "
        "rendered. note: rendered with a note, for data sets with random cameras.",
    )
    path: CameraPath | None = Field(
        None, description="Where it moves to; each frame is an image. None: it stands still."
    )
    rig: SerializeAsAny[RigKeys] | None = Field(
        None,
        description="Several images of one entry, of those that `forestgen models --kind rig` lists; its page has its "
        "keys. None: one.",
    )
    bands: Annotated[SensorFile | None, *shorthand("name")] = Field(
        None,
        description="Sensor whose bands are the image's channels: a name, or a path from the recipe's folder. None: "
        "colour.",
    )
    exposure: Exposure | None = Field(None, description="For a raw image beside the linear one. None: no such.")
    motion: CameraMotion | None = Field(
        None, description="While the exposure's shutter is open: motion blur, rolling shutter. None: it stands still."
    )

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, data: Any) -> Any:
        """What a projection has by default; its own keys that are null are left out."""
        if not isinstance(data, Mapping):
            return data
        filled = {key: value for key, value in data.items() if value is not None or key in Camera.model_fields}
        rig = rig_of(data)
        if filled.get("size_px") is None:
            filled["size_px"] = cls.default_size_px
        if all(filled.get(key) is None for key in ("look", "look_at_m")) and _keeps_view(data, rig):
            filled["look"] = cls.default_look
        return filled

    @model_validator(mode="after")
    def _is_one_camera(self) -> Self:
        wrong = self.wrong_optics() or _rigged(self) or _looking(self) or _looks_at_itself(self) or _exposed(self)
        if wrong is not None:
            raise wrong
        return self

    def wrong_optics(self) -> PydanticCustomError | None:
        """What is wrong with the projection's own keys, or with the image's size for it."""
        return None

    @property
    def field_of_view_deg(self) -> float:
        """Across the image's width; 0 where there is none. A lens' is that of focusing far away."""
        return 0.0

    @property
    def view_width_m(self) -> float:
        """What the image's width shows of the world; 0 where that depends on the distance."""
        return 0.0

    @property
    def lens_mm(self) -> tuple[float, float] | None:
        """Radius of a thin lens' pupil, and its focal length; None for a pinhole."""
        return None

    @property
    def lens_focus_m(self) -> float | None:
        """Distance of a thin lens' plane of focus; None for a pinhole."""
        return None

    @property
    def own_numbers(self) -> Mapping[str, float]:
        """What its projection needs beside these: `Camera.numbers` of the scene has them, and camera.json."""
        return {}

    def footprint_m(self, altitude_m: float) -> tuple[float, float]:
        """Width and height of the level ground that an image shows from above, if the projection `covers_ground`."""
        raise NotImplementedError

    @property
    def rig_part(self) -> Any:
        """The `forestgen.scene.rigs.rig.Rig`, if it has one."""
        return None if self.rig is None else RIGS.load(self.rig.kind)

    @property
    def frames(self) -> int:
        """How many images it makes of one scene."""
        return self.steps if self.rig is None else int(self.rig_part.frames(self))

    @property
    def steps(self) -> int:
        """Points in time of its path, if it has one."""
        return 1 if self.path is None else self.path.frames

    @property
    def frame_names(self) -> list[str]:
        """Names of its images: its own, NAME-0000, NAME-0001, ... along a path, or what its rig says."""
        if self.rig is not None:
            return list(self.rig_part.frame_names(self))
        return [self.name] if self.path is None else [f"{self.name}-{index:04d}" for index in range(self.steps)]

    @property
    def positions_m(self) -> list[Point]:
        """Where it stands in each step, as the recipe counts heights."""
        assert self.position_m is not None
        return _along([self.position_m, *(self.path.position_m if self.path else ())], self.steps)

    @property
    def looks_at_m(self) -> list[Point]:
        """The point in each step's middle, as the recipe counts heights."""
        if self.look is not None:
            (x, y, z) = DIRECTIONS[self.look]
            return [(a + x, b + y, c + z) for a, b, c in self.positions_m]
        assert self.look_at_m is not None
        return _along([self.look_at_m, *(self.path.look_at_m if self.path else ())], self.steps)

    @property
    def moves(self) -> bool:
        """Whether not all images along its path are taken alike."""
        if self.path is None:
            return False
        ways = ((self.position_m, *self.path.position_m), (self.look_at_m, *self.path.look_at_m))
        return any(a != b for way in ways for a, b in pairwise(way))


def _along(points: Sequence[Point], frames: int) -> list[Point]:
    """`frames` points at equal steps of time from the first to the last, through the others at equal times."""
    pieces = len(points) - 1
    if not pieces or frames == 1:
        return [points[0]] * frames
    way = []
    for frame in range(frames):
        # In whole numbers: a frame at a given point is exactly there.
        piece, rest = divmod(frame * pieces, frames - 1)
        if not rest:
            way.append(points[piece])
            continue
        share = rest / (frames - 1)
        x, y, z = (a + share * (b - a) for a, b in zip(points[piece], points[piece + 1], strict=True))
        way.append((x, y, z))
    return way


def rig_of(camera: Mapping[str, Any]) -> Any:
    """The rig that a recipe's camera names; None: it has none, or one that validation will refuse."""
    keys = camera.get("rig")
    kind = keys.get("kind") if isinstance(keys, Mapping) else None
    return RIGS.load(kind) if isinstance(kind, str) and kind in RIGS else None


def _keeps_view(camera: Mapping[str, Any], rig: Any) -> bool:
    """Whether the camera stands and looks as it would without a rig."""
    return bool(rig.keeps_view) if rig is not None else not isinstance(camera.get("rig"), Mapping)


def default_view(camera: Mapping[str, Any], size_m: tuple[float, float]) -> dict[str, Any]:
    """Keys that a recipe's camera has by the site's extent, where it gives none; metres."""
    try:
        of_kind = Camera.class_for(camera)
    except PydanticCustomError:  # validation reports a projection that there is not
        of_kind = Camera
    (width, depth), rig = size_m, rig_of(camera)
    view: dict[str, Any] = {}
    if rig is not None and (keys := rig.with_defaults(camera["rig"], size_m)) != camera["rig"]:
        view["rig"] = keys
    if rig is None or "position_m" not in rig.decides:
        across, along, above_m = of_kind.default_place
        view["position_m"] = [across * width, along * depth, above_m]
    if of_kind.default_look is None and _keeps_view(camera, rig) and camera.get("look") is None:
        view["look_at_m"] = [0.5 * width, 0.6 * depth, 6.0]
    return {key: value for key, value in view.items() if key == "rig" or camera.get(key) is None}


def _article(noun: str) -> str:
    return f"{'an' if noun[:1] in 'aeiou' else 'a'} {noun}"


def _rigged(camera: Camera) -> PydanticCustomError | None:
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


def _looking(camera: Camera) -> PydanticCustomError | None:
    if camera.look is None:
        return None
    if camera.look_at_m is not None or (camera.path is not None and camera.path.look_at_m):
        at = ("look_at_m",) if camera.look_at_m is not None else ("path", "look_at_m")
        return violation("look or look_at_m, not both", problem="two ways to look", got=f"look: {camera.look}", at=at)
    if camera.is_level and camera.look in ("up", "down"):
        expected = "north, east, south or west: what is in the image's middle"
        return violation(expected, problem=f"{_article(camera.kind)} is level", got=camera.look, at="look")
    return None


def _looks_at_itself(camera: Camera) -> PydanticCustomError | None:
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


def _exposed(camera: Camera) -> PydanticCustomError | None:
    """What is wrong with an exposure beside the camera's other keys."""
    if camera.exposure is not None and camera.exposure.ghosts is not None and not camera.has_lens:
        expected, got = "a camera with a lens, such as perspective", _article(camera.kind)
        return violation(
            expected, problem="a lens' ghosts are those of a flat image", got=got, at=("exposure", "ghosts")
        )
    if camera.motion is None or camera.exposure is not None:
        return None
    hint = "exposure: {} is metered, exposure: {shutter_s: 0.002} is not"
    problem, got = "the camera moves for an unknown time", "no exposure"
    return violation("an exposure, whose shutter is open", problem=problem, got=got, hint=hint, at="motion")


def check_cameras(cameras: Sequence[Camera]) -> None:
    """Raise an error of validation if names of images collide or there are too many of them."""
    frames = 0
    owner: dict[str, int] = {}
    for index, camera in enumerate(cameras):
        frames += camera.frames
        if frames > MOST_FRAMES:
            at = (index, "path", "frames") if camera.path else (index, "rig") if camera.rig else (index,)
            expected = f"at most {MOST_FRAMES} frames of all cameras together"
            got = str(sum(one.frames for one in cameras))
            raise violation(expected, problem="too many frames", got=got, at=at)
        for name in {camera.name: None, **dict.fromkeys(camera.frame_names)}:
            # Compared without case: the names become files, and some file systems ignore case.
            first = cameras[owner.setdefault(name.lower(), index)]
            if first is camera:
                continue
            expected, problem = "a different name for each camera", "two cameras of one name"
            got = camera.name
            if first.name.lower() != camera.name.lower():
                expected = "other names than those of a path's frames, NAME-0000, NAME-0001, ..."
                problem, got = f"two images of one name, {name}", f"{camera.name}, beside the camera {first.name}"
            raise violation(expected, problem=problem, got=got, at=(index, "name"))


def check_motion(cameras: Sequence[Camera], *, plants_move: bool) -> None:
    """Raise an error of validation if all images of a path would be the same."""
    for index, camera in enumerate(cameras):
        if camera.path is not None and not camera.moves and not plants_move:
            expected = "points in position_m or look_at_m that differ from the camera's own, or gusty wind"
            problem = "nothing moves along this path: all of its images would be the same"
            got = f"{camera.frames} frames"
            hint = "add path.position_m, set wind.speed_m_per_s and wind.gustiness, or leave the path out"
            raise violation(expected, problem=problem, got=got, hint=hint, at=("cameras", index, "path"))
