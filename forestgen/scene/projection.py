"""What a projection of cameras is, and rays and pixels of cameras by theirs; camera's axes: x right, y down, z forward.

`scene/projections` has one file for each projection that comes along. Depth is the distance along z or along the ray:
a projection says which. A thin lens bends no ray through its middle: those are the projection's. Identity samples go
through fixed points of the lens (`render.identity.tracer`) and meet in the plane of focus at z = focus_m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.registries import PROJECTIONS
from forestgen.scene.motion import is_rolling, poses_at, row_poses, row_times_s
from forestgen.scene.spec import Camera

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_PIECES = 32  # of an edge, where nothing is known of how it bends
_STEP_RAD = 1e-4  # of numerical derivatives
_ROUNDS = 12  # to the row in which a rolling shutter sees a point


@dataclass(frozen=True)
class Rays:
    """Rays of pixels in the camera's axes, of any shape S."""

    origin_m: Floats  # (*S, 3)
    direction: Floats  # (*S, 3) unit
    valid: Bools  # (*S,) False where the image shows nothing: outside of a fisheye's circle


@dataclass(frozen=True)
class WorldRays:
    """Rays through the centres of all pixels, world."""

    origin_m: Floats  # (3,), or (H, W, 3) of parallel rays and of rolling shutters
    direction: Floats  # (H, W, 3) unit
    valid: Bools  # (H, W) False where the image shows nothing


@dataclass(frozen=True)
class Pixels:
    """Where points of the camera's axes appear, of any shape S."""

    x_px: Floats  # (*S,)
    y_px: Floats  # (*S,)
    depth_m: Floats  # (*S,)
    in_front: Bools  # (*S,) False where the camera cannot see: behind it, or outside of a fisheye's circle


@dataclass(frozen=True)
class DeviceRays:
    """R rays of a camera, as device arrays; single precision."""

    direction: Any  # Vector3f, unit; of the camera's axes, or world
    depth_share: Any  # Float, depth by distance: the direction's share along z, or 1 where depth runs along the ray
    shift_m: Any | None = None  # Vector3f: from the camera's place to where the ray begins; None: all begin there
    valid: Any | None = None  # Bool, False where the image shows nothing; None: all are


@dataclass(frozen=True)
class Sensor:
    """A camera of the renderer's own."""

    plugin: Mapping[str, Any]  # its type and optics
    scale: float = 1.0  # of its x and y axes


@dataclass(frozen=True)
class Exchange:
    """A projection as nerfstudio and COLMAP name it."""

    camera_model: str
    distortion: tuple[str, ...]  # keys of its distortion; camera.json has their values
    has_k: bool = True  # focal lengths are those of K; otherwise image coordinates run from -1 to 1 and -1/2 to 1/2


class Projection:
    """A projection: its keys, its rays, where points appear, how files describe it.

    It has no state. `rays` and `project` must be given, which undo each other; all else follows from them, numerically,
    unless it is overridden. Image points are counted in pixels from the image's middle, right and down.
    """

    name: str  # that recipes use: the registry's
    Parameters: type[CameraSection]  # its cameras in recipes: keys, defaults and checks
    model: str  # in camera.json
    is_pinhole: bool = False  # (x, y) = focal_px (X, Y) / Z, as K has it
    is_parallel: bool = False  # rays are parallel to z and begin in the plane of the camera; the sky has no place
    is_equidistant: bool = False  # pixels from the middle are proportional to the angle from the axis
    depth_is_distance: bool = True  # depth runs along the ray; otherwise along z
    wraps_x: bool = False  # the last column neighbours the first
    exchange: Exchange | None = None  # for formats that name cameras as others do

    def rays(self, camera: Camera, x: Floats, y: Floats) -> Rays:
        """Rays through image points; a lens' are those through its middle."""
        raise NotImplementedError

    def project(self, camera: Camera, x: Floats, y: Floats, z: Floats) -> Pixels:
        """Image points of points in the camera's axes, metres; of one at the camera's own place `in_front` is False."""
        raise NotImplementedError

    def device_rays(self, camera: Camera, x: Any, y: Any, lens: Any | None, mi: Any, dr: Any) -> DeviceRays | None:
        """`rays` as code of the tracer, in the camera's axes; None: the tracer takes those of `rays`.

        Parameters
        ----------
        x, y : device arrays.
        lens : Point2f of the unit disc, through which a thin lens' rays go; None: through its middle.
        mi, dr : the renderer's modules, which only `forestgen.render` imports.
        """
        return None

    def sensor(self, camera: Camera) -> Sensor | None:
        """The renderer's own camera of this kind; None: its images are assembled from views by `rays`, `project`."""
        return None

    def pixels_per_sr(self, camera: Camera, toward: Floats) -> Floats:
        """(*S,) image pixels for each steradian around (*S, 3) unit directions."""
        (a, b), (c, d) = self._pixels_a_radian(camera, toward)
        return np.asarray(np.maximum(np.abs(a * d - b * c), 1e-9))

    def _pixels_a_radian(self, camera: Camera, toward: Floats) -> list[tuple[Floats, Floats]]:
        """By how many pixels the image point of each direction moves, along x and y, for a turn in each of two ways."""
        side = np.cross(toward, np.where(np.abs(toward[..., :1]) < 0.6, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
        side /= np.linalg.norm(side, axis=-1, keepdims=True)
        steps = []
        for step in (side, np.cross(toward, side)):
            ends = [self.project(camera, *np.moveaxis(toward + sign * _STEP_RAD * step, -1, 0)) for sign in (-1, 1)]
            across = ends[1].x_px - ends[0].x_px
            if self.wraps_x:
                across = across - camera.size_px[0] * np.round(across / camera.size_px[0])
            steps.append((across / (2 * _STEP_RAD), (ends[1].y_px - ends[0].y_px) / (2 * _STEP_RAD)))
        return steps

    def step_rad(self, camera: Camera, x: Floats, y: Floats, step_px: tuple[float, float]) -> float:
        """At least the angle between diagonal neighbours of an image's grid: columns x (M,), rows y (N,), in steps."""
        toward = self.rays(camera, *np.meshgrid(x, y)).direction
        corners = (toward[:-1, :-1], toward[1:, 1:]), (toward[:-1, 1:], toward[1:, :-1])
        return max(float(2 * np.arcsin(np.linalg.norm(a - b, axis=-1).max() / 2)) for a, b in corners)

    def hull_boxes(self, camera: Camera, seen: Floats, edges: NDArray[np.int64]) -> tuple[Floats, Bools]:
        """Boxes (N, 4) of hulls, left, top, right, bottom in pixels; and which of them may be seen anywhere (N,).

        Here all may be, which costs time: how edges bend is not known.

        Parameters
        ----------
        seen : (N, V, 3) vertices of each instance's hull in the camera's axes, metres.
        edges : (E, 2) of vertices.
        """
        share = (np.arange(_PIECES + 1) / _PIECES)[:, None]
        a, b = seen[:, edges[:, 0], None], seen[:, edges[:, 1], None]
        at = self.project(camera, *np.moveaxis(a + share * (b - a), -1, 0))
        width, height = camera.size_px
        x, y = at.x_px.reshape(len(seen), -1) + width / 2, at.y_px.reshape(len(seen), -1) + height / 2
        hidden = ~at.in_front.reshape(len(seen), -1)
        low = [np.where(hidden, np.inf, one).min(axis=1, initial=np.inf) for one in (x, y)]
        high = [np.where(hidden, -np.inf, one).max(axis=1, initial=-np.inf) for one in (x, y)]
        box = np.stack([*low, *high], axis=1)
        return np.where(np.isfinite(box), box, np.nan), np.ones(len(seen), dtype=np.bool_)

    def finest_pixel_m(self, camera: Camera, distance_m: Floats) -> Floats:
        """(N,) the least that a pixel covers at distances from the camera, across, metres."""
        # In the way in which the image is stretched least: at a panorama's poles, more columns show no more.
        x, y = (((np.arange(_PIECES) + 0.5) / _PIECES - 0.5) * size for size in camera.size_px)
        found = self.rays(camera, *np.meshgrid(x, y))
        (a, b), (c, d) = self._pixels_a_radian(camera, found.direction[found.valid])
        total, area = a * a + b * b + c * c + d * d, np.abs(a * d - b * c)
        most = np.sqrt((total + np.sqrt(np.maximum(total**2 - 4 * area**2, 0.0))) / 2)
        return np.asarray(distance_m / (area / most).max())

    def intrinsics(self, camera: Camera) -> Floats | None:
        """(3, 3) K, with pixel centres at +0.5, as OpenCV has it for its models; None: it has none."""
        return None

    def world_to_ndc(self, camera: Camera, near_m: float) -> Floats | None:
        """(4, 4) from the camera's axes to OpenEXR's ``NDC``, for column vectors; None: no matrix does that."""
        return None

    def screen_window_width(self, camera: Camera) -> float:
        """OpenEXR's ``screenWindowWidth``: of the view at distance 1, or of parallel rays; 1 where there is none."""
        return 1.0

    def file_keys(self, camera: Camera) -> dict[str, Any]:
        """What camera.json has of it, beside the keys of all cameras."""
        return {"hfov_deg": float(camera.hfov_deg), "numbers": dict(camera.numbers)}

    def rim_px(self, camera: Camera) -> float | None:
        """Radius of the circle outside of which the image shows nothing; None: it shows all of itself."""
        return None

    def read(self, values: Mapping[str, Any], size_px: tuple[int, int]) -> FileGeometry:
        """The geometry that camera.json describes.

        What is missing or no number raises KeyError, ValueError or TypeError.
        """
        numbers = {key: float(value) for key, value in values.get("numbers", {}).items()}
        camera = self.plain_camera(size_px, float(values.get("hfov_deg", 0.0)), numbers=numbers)
        found = FileGeometry(camera, (1.0, 1.0), (size_px[0] / 2, size_px[1] / 2))
        found.rays((1, 1))  # raises now what it would raise later
        return found

    def plain_camera(self, size_px: tuple[int, int], hfov_deg: float = 0.0, **keys: Any) -> Camera:
        """A camera at the origin; `keys` are those of `Camera`."""
        return Camera("", (0.0, 0.0, 0.0), np.eye(3), size_px, hfov_deg, projection=self.name, **keys)


@dataclass(frozen=True)
class FileGeometry:
    """Rays and pixels by the numbers of a camera.json, in the camera's axes.

    They are those of `camera`, whose pixels are square and whose axis is in the image's middle, moved and stretched.
    """

    camera: Camera  # at the origin
    focal_px: tuple[float, float]  # along x and y: pixels a slope, a radian, or a metre of parallel rays
    centre_px: tuple[float, float]
    focal_of_angle: float | None = None  # what `focal_px` should be by hfov_deg; None: they do not depend on each other

    @property
    def projection(self) -> Projection:
        return projection_of(self.camera)

    @property
    def size_px(self) -> tuple[int, int]:
        return self.camera.size_px

    @property
    def _stretch(self) -> Floats:
        return np.array([1.0, self.focal_px[1] / self.focal_px[0]])

    @property
    def _middle(self) -> Floats:
        return np.array(self.size_px) / 2

    def project(self, points_m: Floats) -> tuple[Floats, Floats]:
        """(..., 2) pixels and (...) depths of (..., 3) points; what is not in front has no positive depth."""
        at = project(self.camera, points_m)
        flat = (np.stack([at.x_px, at.y_px], axis=-1) - self._middle) * self._stretch
        return flat + self.centre_px, np.where(at.in_front, at.depth_m, -np.abs(at.depth_m))

    def _rays(self, size_px: tuple[int, int]) -> Rays:
        at = (pixel_centres(size_px) - self.centre_px) / self._stretch + self._middle
        return rays(self.camera, *np.moveaxis(at, -1, 0))

    def rays(self, size_px: tuple[int, int]) -> Floats:
        """(H, W, 3) through the pixels' centres, of depth 1."""
        found = self._rays(size_px).direction
        return found if self.projection.depth_is_distance else found / found[..., 2:]

    def starts(self, size_px: tuple[int, int]) -> Floats:
        """(H, W, 3) from the camera's place to where the pixels' rays begin."""
        return self._rays(size_px).origin_m

    def sees(self, size_px: tuple[int, int]) -> Bools:
        """(H, W) whether a pixel's centre has a ray."""
        beyond_px = self.beyond_rim_px(pixel_centres(size_px))
        return self._rays(size_px).valid if beyond_px is None else np.asarray(beyond_px <= 0)

    def beyond_rim_px(self, at_px: Floats) -> Floats | None:
        """(...) how far (..., 2) image points lie outside of what the image shows; None: it shows all of itself."""
        rim_px = self.projection.rim_px(self.camera)
        return None if rim_px is None else np.asarray(np.linalg.norm(at_px - self.centre_px, axis=-1) - rim_px)


def pixel_centres(size_px: tuple[int, int]) -> Floats:
    """(H, W, 2) image points."""
    width, height = size_px
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def matrix_k(camera: Camera, focal_px: float) -> Floats:
    """(3, 3) with square pixels and the image's middle, pixel centres at +0.5."""
    width, height = camera.size_px
    return np.array([[focal_px, 0.0, width / 2.0], [0.0, focal_px, height / 2.0], [0.0, 0.0, 1.0]])


def read_angle_rad(values: Mapping[str, Any]) -> float:
    """A camera.json's field of view; ValueError: it is no angle."""
    angle = np.radians(float(values["hfov_deg"]))
    if not 0 < angle <= 2 * np.pi + 1e-9:
        raise ValueError("hfov_deg is no field of view")
    return float(angle)


def read_k(values: Mapping[str, Any]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Focal lengths and the image's centre of a camera.json's K; ValueError: it is none without skew."""
    k = np.asarray(values["K"], dtype=np.float64)
    if k.shape != (3, 3) or not np.isfinite(k).all():
        raise ValueError("expected (3, 3) finite numbers")
    if (
        not all(1e-3 < focal_px < 1e9 for focal_px in (k[0, 0], k[1, 1]))
        or (k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0).any()
        or k[2, 2] != 1
    ):
        raise ValueError("K is not of a camera without skew")
    return (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2]))


def load_projection(name: str, *, where: str | None = None) -> Projection:
    """The projection of a name; raises `RecipeError` as `Registry.load` does."""
    found: Projection = PROJECTIONS.load(name, where=where)
    return found


def projection_of_model(model: str) -> Projection | None:
    """The projection whose name in camera.json is `model`; None: there is none."""
    return next((one for one in map(load_projection, PROJECTIONS) if one.model == model), None)


def projection_of(camera: Camera) -> Projection:
    """The projection of a camera."""
    return load_projection(camera.projection)


def rays(camera: Camera, x_px: Floats, y_px: Floats) -> Rays:
    """Rays through image points; a lens' are those through its middle."""
    width, height = camera.size_px
    x, y = np.broadcast_arrays(np.asarray(x_px, np.float64) - width / 2, np.asarray(y_px, np.float64) - height / 2)
    return projection_of(camera).rays(camera, x, y)


def centre_rays(camera: Camera) -> Rays:
    """(H, W) rays through the pixels' centres, in the camera's axes."""
    width, height = camera.size_px
    return rays(camera, *np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5))


def check_projection(camera: Camera) -> None:
    """Raise `RecipeError` for a projection whose rays and image points are not those of one another."""
    size = np.array(camera.size_px)
    at = (np.stack(np.meshgrid(*(2 * [np.linspace(0.05, 0.95, 7)])), axis=-1) * size).reshape(-1, 2)
    with np.errstate(all="ignore"):
        found = rays(camera, *at.T)
        shown, straight = found.valid, found.direction[found.valid]
        back = project(camera, found.origin_m[shown] + 10.0 * straight)
        off_px = np.abs(np.stack([back.x_px, back.y_px], axis=-1) - at[shown]).max(initial=0.0)
        is_unit = np.abs(np.linalg.norm(straight, axis=-1) - 1.0).max(initial=0.0) < 1e-6
    if shown.any() and is_unit and off_px < 0.01 and back.in_front.all():
        return
    problem = f"the projection {camera.projection} contradicts itself at these keys of the camera"
    got = f"points that appear up to {off_px:.3g} pixels away" if is_unit else "directions that are no unit vectors"
    got = got if shown.any() else "no ray at any of 49 image points"
    hint = "its `rays` and `project` must undo each other; they get a key of their own as `camera.numbers`, which the "
    hint += "keys' class fills in `own_numbers`, and `camera.hfov_deg`, which it fills in `field_of_view_deg`"
    where, expected = "kind", "unit directions, each of which `project` shows where its pixel is"
    raise RecipeError(problem, where=where, expected=expected, got=got, hint=hint)


def world_rays(camera: Camera, rows: slice | None = None) -> WorldRays:
    """Rays through the pixels' centres in the middle of their exposure, of some rows or of all, world."""
    width, height = camera.size_px
    own = rays(camera, *np.meshgrid(np.arange(width) + 0.5, np.arange(height)[rows or slice(None)] + 0.5))
    place, axes = row_poses(camera, rows)
    across, origin = axes.swapaxes(-1, -2), np.asarray(camera.position_m, dtype=np.float64)
    if projection_of(camera).is_parallel:
        origin = own.origin_m @ across + origin
    direction = own.direction @ across
    if is_rolling(camera):
        origin = np.ascontiguousarray(np.broadcast_to(origin + place, direction.shape))
    return WorldRays(origin, direction, own.valid)


def in_own_axes(camera: Camera, away_m: Floats, near: Bools | None = None) -> Floats:
    """(*S, 3) in the camera's axes of points by their way from `position_m`, world; for `project`.

    A rolling shutter sees a point in the row whose pose shows it there, found by going from row to time to row; where
    things fly through the image faster than it is read out there may be none, or several. `near` (*S,): False where
    `away_m` is a direction, which only turns.
    """
    if not is_rolling(camera):
        return np.asarray(away_m @ camera.world_from_camera)
    own = away_m @ np.asarray(camera.world_from_camera)
    for _ in range(_ROUNDS):
        row_px = np.nan_to_num(project(camera, own).y_px, nan=0.5 * camera.size_px[1])
        place, axes = poses_at(camera, row_times_s(camera, row_px))
        from_there = away_m - (place if near is None else np.where(near[..., None], place, 0.0))
        own = np.einsum("...k,...kj->...j", from_there, axes)
    return np.asarray(own)


def project(camera: Camera, points_m: Floats) -> Pixels:
    """Image points of (*S, 3) points in the camera's axes; of a point at the camera's own place, `in_front` is False.

    Where `in_front` is False the image point of a pinhole or of parallel rays means nothing; a fisheye's is where its
    map goes on beyond the circle.
    """
    width, height = camera.size_px
    x, y, z = np.moveaxis(np.asarray(points_m, dtype=np.float64), -1, 0)
    at = projection_of(camera).project(camera, x, y, z)
    return Pixels(at.x_px + width / 2, at.y_px + height / 2, at.depth_m, at.in_front)


def image_circle(camera: Camera) -> Bools:
    """(H, W) pixels whose centre sees something: all but those outside of a fisheye's circle."""
    return centre_rays(camera).valid
