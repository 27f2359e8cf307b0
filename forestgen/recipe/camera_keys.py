"""Keys of a recipe's cameras, and what follows from them; `cameras.Camera` checks them.

A camera with a path is as many images as the path has frames. Times run in equal steps over the whole path; each of
the two lists of points is a polyline of its own over that time, every piece of it as long in time as the next.
A camera with a rig (recipe/rigs.py) is several images, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from forestgen.recipe.exposure import Exposure
from forestgen.recipe.fields import Flag, Name, Number, Point, Positive, Section, Text, Whole, spelled_out
from forestgen.recipe.rigs import MOST_FRAMES, DroneGrid, FramesPerSecond, GroundPoint, Orbit, Rig, Stereo, Walk
from forestgen.recipe.spectra import MOST_BYTES

Pixels = Annotated[Whole, Field(ge=8, le=16384)]
Kind = Literal["perspective", "fisheye", "orthographic", "panorama"]
Look = Literal["up", "down", "north", "east", "south", "west"]
DIRECTIONS: dict[str, Point] = {  # right, down and forward follow: see core/frames.py
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
    "north": (0.0, 1.0, 0.0),
    "east": (1.0, 0.0, 0.0),
    "south": (0.0, -1.0, 0.0),
    "west": (-1.0, 0.0, 0.0),
}
FULL_FRAME_MM = 36.0
_SIZE_PX = {"fisheye": (512, 512), "orthographic": (512, 512), "panorama": (1024, 512)}
_HFOV_DEG = {"perspective": 60.0, "fisheye": 180.0}
_LOOK: dict[str, Look] = {"fisheye": "up", "orthographic": "down", "panorama": "north"}


class SensorFile(Section):
    """A table of the responses of a sensor's bands by wavelength; see recipe/spectra.py."""

    name: Annotated[Text, Field(min_length=1, max_length=1000, description="Such as sentinel2a, or a path.")]
    text: Annotated[
        Text | None,
        Field(max_length=MOST_BYTES, description="The table itself, as drawn recipes keep a file of your own."),
    ] = None


class CameraPath(Section):
    """A camera's way from where it stands, through points, in equal times; straight lines between them."""

    frames: Annotated[Whole, Field(ge=2, le=MOST_FRAMES, description="Images along the way, both ends included.")]
    frames_per_s: Annotated[FramesPerSecond, Field(description="Images a second: of motion and wind.")] = 24.0
    position_m: Annotated[
        tuple[Point, ...],
        Field(max_length=1000, description="Points it passes after position_m: x, y, z, metres."),
    ] = ()
    look_at_m: Annotated[
        tuple[Point, ...], Field(max_length=1000, description="Points in the image's middle after look_at_m, metres.")
    ] = ()


class CameraKeys(Section):
    """A camera; site frame: x east, y north, z up, metres."""

    name: Annotated[Name, Field(description="Name in file names; default camera0, camera1, ...")]
    kind: Annotated[
        Kind,
        Field(
            description="Projection: perspective, fisheye (equidistant), orthographic, panorama (equirectangular, all "
            "around, level)."
        ),
    ] = "perspective"
    position_m: Annotated[
        Point | None,
        Field(
            description="Where it stands: x, y, z, metres. Default: eye level, southern edge's middle; fisheye and "
            "panorama: eye level amid the site; orthographic: 100 m above that."
        ),
    ] = None
    look_at_m: Annotated[
        Point | None, Field(description="The point in the image's middle: x, y, z, metres. Default: amid the site.")
    ] = None
    look: Annotated[
        Look | None,
        Field(
            description="Instead of look_at_m. Up and down have north at the top: down shows east on the right, up "
            "shows it on the left. Default: fisheye up, orthographic down, panorama north."
        ),
    ] = None
    size_px: Annotated[
        tuple[Pixels, Pixels],
        Field(
            description="Width and height of the image, pixels. Default for fisheye and orthographic: [512, 512]; for "
            "panorama: [1024, 512]."
        ),
    ] = (640, 360)
    hfov_deg: Annotated[
        Number | None,
        Field(
            ge=0.1,
            le=360,
            description="Field of view across the image's width, degrees: of perspective (default 60, at most 170) and "
            "fisheye (default 180: the circle that a square image holds).",
        ),
    ] = None
    focal_length_mm: Annotated[
        Positive | None, Field(le=10_000, description="Of perspective, instead of hfov_deg; with sensor_width_mm.")
    ] = None
    sensor_width_mm: Annotated[
        Positive | None, Field(le=1000, description="Of perspective: what the image's width is on. Default: 36.")
    ] = None
    f_number: Annotated[
        Positive | None,
        Field(ge=0.5, le=1000, description="Of perspective, with focus_m: a thin lens, its focal length by this wide."),
    ] = None
    focus_m: Annotated[
        Positive | None, Field(le=1e5, description="Distance of the plane that a thin lens shows sharply, metres.")
    ] = None
    width_m: Annotated[
        Positive | None, Field(le=1e5, description="Of orthographic: what the image's width shows, metres.")
    ] = None
    height_above_ground: Annotated[
        Flag, Field(description="Whether the z of position_m and look_at_m count from the ground below or from z = 0.")
    ] = True
    obstructed: Annotated[
        Literal["error", "note"],
        Field(
            description="How a camera below the ground, in a house or in a trunk is treated. error: reported before it "
            "is rendered. note: rendered with a note, for data sets with random cameras."
        ),
    ] = "error"
    path: Annotated[
        CameraPath | None, Field(description="Where it moves to; each frame is an image. None: it stands still.")
    ] = None
    rig: Annotated[
        Rig | None, Field(description="Several images of one entry: stereo, orbit, walk or drone_grid. None: one.")
    ] = None
    bands: Annotated[
        SensorFile | None,
        Field(
            description="Sensor whose bands are the image's channels: a name, or a path from the recipe's folder. "
            "None: colour."
        ),
    ] = None
    exposure: Annotated[Exposure | None, Field(description="For a raw image beside the linear one. None: no such.")] = (
        None
    )

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, data: Any) -> Any:
        """What a kind has by default, and the f-number that lens and exposure share."""
        if not isinstance(data, Mapping):
            return data
        filled, kind = dict(data), data.get("kind", "perspective")
        rig = data.get("rig")
        rigged = rig.get("kind") if isinstance(rig, Mapping) else None
        if not isinstance(kind, str):
            return data
        if filled.get("size_px") is None:
            filled["size_px"] = _SIZE_PX.get(kind, (640, 360))
        if filled.get("hfov_deg") is None and filled.get("focal_length_mm") is None:
            filled["hfov_deg"] = _HFOV_DEG.get(kind)
        if all(filled.get(key) is None for key in ("look", "look_at_m")) and rigged in (None, "stereo"):
            filled["look"] = _LOOK.get(kind)
        exposure, f_number = data.get("exposure"), data.get("f_number")
        if isinstance(exposure, Mapping) and f_number is not None:
            filled["exposure"] = {"f_number": f_number, **exposure}
        return filled

    @field_validator("bands", mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        return spelled_out(value, "name")

    @property
    def field_of_view_deg(self) -> float:
        """Across the image's width; 0 where there is none. A lens' is that of focusing far away."""
        if self.hfov_deg is not None:
            return self.hfov_deg
        return 0.0 if self.focal_length_mm is None else _field_of_view_deg(self.focal_length_mm, self.sensor_mm)

    @property
    def lens_mm(self) -> tuple[float, float] | None:
        """Radius of the thin lens' pupil, and its focal length; None for a pinhole."""
        if self.f_number is None:
            return None
        focal = self.focal_length_mm
        if focal is None:
            focal = self.sensor_mm / 2 / math.tan(math.radians(self.field_of_view_deg) / 2)
        return focal / self.f_number / 2, focal

    @property
    def footprint_m(self) -> tuple[float, float]:
        """Width and height of the level ground that a drone's image shows."""
        width, height = self.size_px
        assert isinstance(self.rig, DroneGrid)
        if self.width_m is not None:
            return self.width_m, self.width_m * height / width
        across = 2 * self.rig.altitude_m * math.tan(math.radians(self.field_of_view_deg) / 2)
        return across, across * height / width

    @property
    def rig_middles_m(self) -> list[GroundPoint]:
        """Middles of a drone grid's images, on the map."""
        assert isinstance(self.rig, DroneGrid)
        return self.rig.middles_m(self.footprint_m)

    @property
    def frames(self) -> int:
        """How many images it makes of one scene."""
        if isinstance(self.rig, DroneGrid):
            lines, images = self.rig.lines(self.footprint_m)
            return lines * images
        if isinstance(self.rig, Orbit):
            return self.rig.count
        if isinstance(self.rig, Walk):
            return self.rig.frames
        return self.steps * (1 if self.rig is None else 2)

    @property
    def steps(self) -> int:
        """Points in time of its path, if it has one."""
        return 1 if self.path is None else self.path.frames

    @property
    def frame_names(self) -> list[str]:
        """Names of its images: its own, or NAME-0000, NAME-0001, ...; and -left and -right after NAME."""
        names = [self.name] if not isinstance(self.rig, Stereo) else [f"{self.name}-left", f"{self.name}-right"]
        if self.path is None and isinstance(self.rig, Stereo | None):
            return names
        return [f"{name}-{index:04d}" for index in range(self.frames // len(names)) for name in names]

    @property
    def positions_m(self) -> list[Point]:
        """Where it stands in each step, as the recipe counts heights; of a stereo rig the middle."""
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

    @property
    def sensor_mm(self) -> float:
        """Width of a perspective camera's sensor."""
        return FULL_FRAME_MM if self.sensor_width_mm is None else self.sensor_width_mm


def _field_of_view_deg(focal_length_mm: float, sensor_width_mm: float) -> float:
    return math.degrees(2 * math.atan(sensor_width_mm / 2 / focal_length_mm))


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


def default_view(camera: Mapping[str, Any], size_m: tuple[float, float]) -> dict[str, Any]:
    """Keys that a recipe's camera has by the site's extent, where it says nothing itself; metres.

    Eye level at the middle of the southern edge, looking north over the site; fisheye and panorama in its middle.
    """
    (width, depth), kind, rig = size_m, camera.get("kind", "perspective"), camera.get("rig")
    rigged = rig.get("kind") if isinstance(rig, Mapping) else None
    if rigged == "drone_grid":
        assert isinstance(rig, Mapping)
        # A bad area is left for validation to name.
        return {"rig": {**rig, "area_m": [[0.0, 0.0], [width, depth]]}} if rig.get("area_m") is None else {}
    view: dict[str, Any] = {}
    if rigged not in ("orbit", "walk"):
        view["position_m"] = {
            "fisheye": [0.5 * width, 0.5 * depth, 1.7],
            "panorama": [0.5 * width, 0.5 * depth, 1.7],
            "orthographic": [0.5 * width, 0.5 * depth, 100.0],
        }.get(str(kind), [0.5 * width, 0.02 * depth, 1.7])
    if kind == "perspective" and rigged in (None, "stereo") and camera.get("look") is None:
        view["look_at_m"] = [0.5 * width, 0.6 * depth, 6.0]
    return {key: value for key, value in view.items() if camera.get(key) is None}
