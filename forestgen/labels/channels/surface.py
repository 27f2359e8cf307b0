"""Label channels of what the ray through each pixel's centre meets.

- `surface`: positions and normals, and which triangle it is
- `albedo`: reflectance and transmittance
- `sun`: whether the sun's centre is visible from it, or by night the moon's
- `cloud`: opacity of the clouds along the ray
- `module`: which branch module, and which segment of it

A module's number is its own within its plant for life (`architecture/modules.py`), so a branch is named by the plant's
id, the module's number and the node of the module's prototype that ends the segment. Twigs and leaves that are drawn on
a segment are that segment's. A plant that another one stands for shows that one's branches: `is_own` is false then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.prototypes import MOST_NODES
from forestgen.atmosphere.optical_depth import cloud_opacity
from forestgen.labels.channels.channel import ChannelView, LabelChannel, Layers, layer, layers
from forestgen.labels.labelled import LabelledFrame
from forestgen.plants.exemplar import Exemplar
from forestgen.render.frame import Branches, Frame, Surface
from forestgen.scene.motion import row_poses
from forestgen.scene.projection import centre_rays, projection_of, world_rays
from forestgen.scene.spec import Camera


class SurfaceChannel(LabelChannel):
    """Positions, normals and triangles at the pixels' centres."""

    name = "surface"
    units: Mapping[str, str] = {
        "position": "m, world",
        "position.camera": "m, camera's axes",
        "normal": "1, world",
        "normal.camera": "1, camera's axes",
        "normal.shading": "1, world",
        "normal.shading.camera": "1, camera's axes",
    }

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        surface, camera = labelled.frame.surface, labelled.frame.camera
        _, rotation = row_poses(camera)
        return {
            "normal": layers("XYZ", surface.normal),
            "normal.camera": layers("XYZ", _turned(surface.normal, rotation)),
            "normal.shading": layers("XYZ", surface.shading_normal),
            "normal.shading.camera": layers("XYZ", _turned(surface.shading_normal, rotation)),
            "position": layers("XYZ", surface.position_m),
            "position.camera": layers("XYZ", camera_position_m(surface.depth_m, camera)),
            "identity": {
                **layer("centre.plant_id", surface.plant_id),
                **layer("centre.part", surface.part),
                **layer("centre.exemplar", surface.exemplar),
                **layer("centre.face", surface.face),
            },
        }


class Albedo(LabelChannel):
    """Reflectance and transmittance of surfaces."""

    name = "albedo"
    units: Mapping[str, str] = {"albedo": "1, linear Rec. 709 (D65)"}

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"albedo": layers("RGB", labelled.frame.surface.albedo)}


class Sun(LabelChannel):
    """Shadows: where the sun is visible, or by night the moon."""

    name = "sun"

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"sun": layer("visible", labelled.frame.surface.sun_visible)}


class Cloud(LabelChannel):
    """Opacity of clouds."""

    name = "cloud"
    units: Mapping[str, str] = {"cloud": "1"}

    def add(self, frame: Frame, view: ChannelView) -> Frame:
        """0 everywhere under a clear sky."""
        distance_m, clouds = frame.surface.distance_m, view.tracer.spec.clouds
        if clouds is None:
            return replace(frame, cloud_opacity=np.zeros(distance_m.shape, dtype=np.float32))
        with view.timings("cloud opacity"):
            rays = world_rays(frame.camera)
            far_m = np.where(rays.valid, distance_m, np.float32(0))
            return replace(frame, cloud_opacity=cloud_opacity(clouds, rays.origin_m, rays.direction, far_m))

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"cloud": layer("opacity", labelled.frame.cloud_opacity)}


class Module(LabelChannel):
    """Branch modules and their segments."""

    name = "module"

    def add(self, frame: Frame, view: ChannelView) -> Frame:
        return replace(frame, branches=branch_labels(frame.surface, view.tracer.spec.exemplars))

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        branches = labelled.frame.branches
        if branches is None:
            return {}
        return {
            "module": layer("number", branches.module) | layer("node", branches.node) | layer("own", branches.is_own)
        }


SURFACE, ALBEDO, SUN, CLOUD, MODULE = SurfaceChannel(), Albedo(), Sun(), Cloud(), Module()


def camera_position_m(depth_m: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """(H, W, 3) in the camera's axes, of pixel centres: exact far from the world's origin too; NaN for the sky."""
    depth = np.where(np.isfinite(depth_m), depth_m, np.nan).astype(np.float64)
    projection = projection_of(camera)
    if not projection.is_pinhole:
        rays = centre_rays(camera)
        along = rays.direction if projection.depth_is_distance else rays.direction / rays.direction[..., 2:]
        return (rays.origin_m + along * depth[..., None]).astype(np.float32)
    x, y = camera.pixel_slopes
    return np.stack([depth * x, depth * y[:, None], depth], axis=-1).astype(np.float32)


def _turned(vectors: NDArray[np.float32], world_from_camera: NDArray[np.float64]) -> NDArray[np.float32]:
    return (vectors @ world_from_camera).astype(np.float32)


def branch_labels(surface: Surface, exemplars: Sequence[Exemplar]) -> Branches:
    """Look up the surface's triangles in the scene's exemplars."""
    shape = surface.exemplar.shape
    module, node = np.zeros(shape, dtype=np.uint32), np.zeros(shape, dtype=np.uint32)
    is_own = np.zeros(shape, dtype=np.bool_)
    for index in np.unique(surface.exemplar[surface.exemplar > 0]).tolist():
        marks = exemplars[index - 1].marks()
        if marks is None:
            continue
        seen = surface.exemplar == index
        found = marks[surface.face[seen]]
        module[seen], node[seen] = found // MOST_NODES + 1, found % MOST_NODES
        is_own[seen] = exemplars[index - 1].is_unique
    return Branches(module, node, is_own)
