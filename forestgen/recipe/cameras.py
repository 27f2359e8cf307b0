"""Cameras of a recipe, and their paths.

A camera with a path is as many images as the path has frames. Times run in equal steps over the whole path; each of
the two lists of points is a polyline of its own over that time, every piece of it as long in time as the next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from forestgen.recipe.fields import Flag, Name, Number, Point, Section, Whole, mistake

MOST_FRAMES = 1000  # of all cameras together
Pixels = Annotated[Whole, Field(ge=8, le=16384)]


class CameraPath(Section):
    """A camera's way from where it stands, through points, in equal times; straight lines between them."""

    frames: Annotated[Whole, Field(ge=2, le=MOST_FRAMES, description="Images along the way, both ends included.")]
    frames_per_s: Annotated[Number, Field(ge=0.001, le=1000, description="Images a second: of motion and wind.")] = 24.0
    position_m: Annotated[
        tuple[Point, ...],
        Field(max_length=1000, description="Points it passes after position_m: x, y, z, metres."),
    ] = ()
    look_at_m: Annotated[
        tuple[Point, ...], Field(max_length=1000, description="Points in the image's middle after look_at_m, metres.")
    ] = ()


class Camera(Section):
    """A camera; site frame: x east, y north, z up, metres."""

    name: Annotated[Name, Field(description="Name in file names; default camera0, camera1, ...")]
    kind: Annotated[Literal["perspective"], Field(description="Projection.")] = "perspective"
    position_m: Annotated[
        Point, Field(description="Where it stands: x, y, z, metres. Default: eye level, southern edge's middle.")
    ]
    look_at_m: Annotated[
        Point, Field(description="The point in the image's middle: x, y, z, metres. Default: amid the site.")
    ]
    size_px: Annotated[tuple[Pixels, Pixels], Field(description="Width and height of the image, pixels.")] = (640, 360)
    hfov_deg: Annotated[Number, Field(ge=0.1, le=170, description="Horizontal field of view, degrees.")] = 60.0
    height_above_ground: Annotated[
        Flag, Field(description="Whether the z of position_m and look_at_m count from the ground below or from z = 0.")
    ] = True
    path: Annotated[
        CameraPath | None, Field(description="Where it moves to; each frame is an image. None: it stands still.")
    ] = None

    @property
    def frames(self) -> int:
        """How many images it makes of one scene."""
        return 1 if self.path is None else self.path.frames

    @property
    def frame_names(self) -> list[str]:
        """Names of its images: its own, or NAME-0000, NAME-0001, ... along a path."""
        return [self.name] if self.path is None else [f"{self.name}-{index:04d}" for index in range(self.frames)]

    @property
    def positions_m(self) -> list[Point]:
        """Where it stands in each frame, as the recipe counts heights."""
        return _along([self.position_m, *(self.path.position_m if self.path else ())], self.frames)

    @property
    def looks_at_m(self) -> list[Point]:
        """The point in each frame's middle, as the recipe counts heights."""
        return _along([self.look_at_m, *(self.path.look_at_m if self.path else ())], self.frames)

    @property
    def moves(self) -> bool:
        """Whether not all of its images are taken alike."""
        if self.path is None:
            return False
        ways = ((self.position_m, *self.path.position_m), (self.look_at_m, *self.path.look_at_m))
        return any(a != b for way in ways for a, b in pairwise(way))

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        # Heights above ground do not matter: a point above another has the same ground.
        for index, (position, look_at) in enumerate(zip(self.positions_m, self.looks_at_m, strict=True)):
            if math.dist(position, look_at) < 1e-6:
                start = self.path is None or index == 0
                at: tuple[str, ...] = ("look_at_m",) if start else ("path",)
                if not start and self.path is not None:
                    at += ("look_at_m",) if self.path.look_at_m else ("position_m",)
                raise mistake(
                    "a look_at_m away from position_m" + ("" if start else " all the way"),
                    problem="the camera looks at itself" + ("" if start else f" in frame {index} of its path"),
                    got=str([round(x, 6) for x in look_at]),
                    at=at,
                )
        return self


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
                at=(index, "path", "frames") if camera.path else (index,),
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
