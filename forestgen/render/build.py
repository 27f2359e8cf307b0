"""SceneSpec -> Mitsuba scenes.

Everything is shifted so that the camera's foot is the origin: the renderer lifts ray origins by about 9e-5 of their
distance from the origin, which far from it brightens thin leaves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import SurfaceTexture
from forestgen.render.variant import mitsuba
from forestgen.scene.spec import Camera, Material, SceneSpec

LEAFLIKE = (Part.LEAF, Part.FLOWER)


def origin_of(camera: Camera) -> NDArray[np.float64]:
    """(3,) metres, world: the point that the renderer's frame has as its origin for `camera`."""
    return np.asarray(camera.position_m, dtype=np.float64)


def to_mesh(
    mesh: Mesh, bsdf: Any | None = None, offset_m: NDArray[np.float64] | None = None, name: str = "mesh"
) -> Any:
    """A Mitsuba mesh of the current variant; without a `bsdf` it has geometry only."""
    mi = mitsuba()
    properties = mi.Properties()
    if bsdf is not None:
        properties["mesh_bsdf"] = bsdf
    shaded = bsdf is not None
    normals, uv = (mesh.normals if shaded else None), (mesh.uv if shaded else None)
    result = mi.Mesh(
        name,
        vertex_count=len(mesh.vertices_m),
        face_count=len(mesh.faces),
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=uv is not None,
        props=properties,
    )
    vertices = mesh.vertices_m if offset_m is None else (mesh.vertices_m - offset_m).astype(np.float32)
    parameters = mi.traverse(result)
    parameters["vertex_positions"] = np.ascontiguousarray(vertices).ravel()
    parameters["faces"] = np.ascontiguousarray(mesh.faces).ravel()
    if normals is not None:
        parameters["vertex_normals"] = np.ascontiguousarray(normals).ravel()
    if uv is not None:
        parameters["vertex_texcoords"] = np.ascontiguousarray(uv).ravel()
    parameters.update()
    return result


def leaf_bsdf(material: Material) -> dict[str, Any]:
    """A thin two-sided leaf: a blend of a pure reflector and a pure transmitter.

    `principledthin` without specular transmission is a nearly Lambertian reflector at diff_trans 0 and a Lambertian
    transmitter at diff_trans 2. The transmitter's share is t / (r + t), by the largest channels, so that each lobe's
    colour is at most r + t and is never clipped. Within 0.9% of the material up to 60 degrees, on both sides:
    tests/system/test_leaf.py integrates R and T.

    The material's roughness is left out. Without specular transmission this BSDF has no mirror-like lobe; its roughness
    changes only the light thrown back, and with it R: by -1.8% (roughness 0.1) to +3.0% (0.9) at normal incidence,
    -10% to +15% at 75 degrees. At 0.5 R is right.
    """
    r, t = max(material.reflectance), max(material.transmittance)
    share = t / (r + t) if r + t > 0 else 0.5

    def lobe(colour: tuple[float, float, float], weight: float, diff_trans: float) -> dict[str, Any]:
        return {
            "type": "principledthin",
            "base_color": {"type": "rgb", "value": [min(c / weight, 1.0) if weight > 0 else 0.0 for c in colour]},
            "roughness": 0.5,
            "eta": 1.5,
            "diff_trans": diff_trans,
        }

    return {
        "type": "blendbsdf",
        "weight": share,
        "r": lobe(material.reflectance, 1.0 - share, 0.0),
        "t": lobe(material.transmittance, share, 2.0),
    }


def surface_bsdf(part: Part, material: Material, *, has_uv: bool = False) -> dict[str, Any]:
    """BSDF of a plant's surface; a texture needs a mesh with uv."""
    if part in LEAFLIKE:
        return leaf_bsdf(material)
    if material.texture is not None and has_uv:
        return textured_bsdf(material.texture)
    return {
        "type": "twosided",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(material.reflectance)}},
    }


def textured_bsdf(texture: SurfaceTexture) -> dict[str, Any]:
    """Diffuse surface with a colour and a normal map.

    Under a sky that is equally bright everywhere, a facet that leans from the surface by an angle a gets only
    (1 + cos a) / 2 of what the surface gets: the rest of its hemisphere lies below the surface. What it misses there
    would come from the facet opposite. The colour is divided by that share, so that the mean reflectance stays the
    texture's own. The renderer's shading of the terminator would take some more, and stays off.
    """
    normals = texture.normals()
    seen = 0.5 + 0.5 * normals[..., 2:]
    colour = np.minimum(texture.colour / seen, 1.0)
    return {
        "type": "twosided",
        "bsdf": {
            "type": "normalmap",
            "use_shadowing_function": False,
            "normalmap": _bitmap(0.5 + 0.5 * normals),
            "bsdf": {"type": "diffuse", "reflectance": _bitmap(colour)},
        },
    }


def _bitmap(image: NDArray[np.float32]) -> dict[str, Any]:
    """A texture of linear values, row 0 at v = 0, that repeats."""
    bitmap = mitsuba().Bitmap(np.ascontiguousarray(image, dtype=np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat", "format": "fp16"}


def ground_bsdf(spec: SceneSpec) -> dict[str, Any]:
    """Diffuse ground: the terrain's texture on the site, one colour in the distance."""
    mi = mitsuba()
    bitmap = mi.Bitmap(np.ascontiguousarray(spec.terrain.texture))
    texture = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat"}
    far = {"type": "rgb", "value": list(spec.terrain.far_reflectance)}
    return {
        "type": "twosided",
        "bsdf": {
            "type": "blendbsdf",
            "weight": {"type": "mesh_attribute", "name": "vertex_far_share"},
            "near": {"type": "diffuse", "reflectance": texture},
            "far": {"type": "diffuse", "reflectance": far},
        },
    }


def transform_of(matrix: NDArray[np.float64], shift_m: NDArray[np.float64]) -> Any:
    """A Mitsuba transform of a (3, 4) matrix, in the frame shifted by `shift_m`."""
    full = np.eye(4)
    full[:3] = matrix
    full[:3, 3] -= shift_m
    return mitsuba().ScalarTransform4f(full)


def plants_dict(spec: SceneSpec, origin_m: NDArray[np.float64], *, shaded: bool) -> dict[str, Any]:
    """Shape groups and instances. Instance i has the key ``instance-i``, so tables can follow its order."""
    mi = mitsuba()
    scene: dict[str, Any] = {}
    used = np.unique(spec.instances.exemplar)
    bsdfs: dict[tuple[str, str, bool], Any] = {}
    for index in used:
        exemplar = spec.exemplars[index]
        group: dict[str, Any] = {"type": "shapegroup"}
        for number, organ in enumerate(exemplar.organs):
            bsdf = None
            if shaded:
                has_uv = organ.mesh.uv is not None
                key = (exemplar.species, organ.material, has_uv)
                if key not in bsdfs:
                    material = spec.materials[exemplar.species, organ.material]
                    bsdfs[key] = mi.load_dict(surface_bsdf(organ.part, material, has_uv=has_uv))
                bsdf = bsdfs[key]
            group[f"organ-{number:02d}"] = to_mesh(organ.mesh, bsdf, name=f"{exemplar.species}-{number}")
        scene[f"exemplar-{index}"] = group
    reference = {int(index): {"type": "ref", "id": f"exemplar-{index}"} for index in used}
    for row, (exemplar_index, transform) in enumerate(
        zip(spec.instances.exemplar, spec.instances.transform, strict=True)
    ):
        scene[f"instance-{row}"] = {
            "type": "instance",
            "to_world": transform_of(transform, origin_m),
            "exemplar": reference[int(exemplar_index)],
        }
    return scene


def sky_emitter(spec: SceneSpec, *, sun: bool, sky: bool) -> dict[str, Any]:
    """Mitsuba's sun and sky, or one of the two alone."""
    return {
        "type": "sunsky",
        "sun_direction": [float(x) for x in sun_direction(spec)],
        "turbidity": spec.sky.turbidity,
        "albedo": spec.sky.ground_albedo,
        "sun_scale": 1.0 if sun else 0.0,
        "sky_scale": 1.0 if sky else 0.0,
    }


def sun_direction(spec: SceneSpec) -> NDArray[np.float64]:
    """(3,) unit vector from the site to the sun, world frame."""
    elevation, azimuth = np.radians([spec.sky.sun_elevation_deg, spec.sky.sun_azimuth_deg])
    return np.array([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)])


@dataclass(frozen=True)
class FilmWindow:
    """Rows and columns of the image that a pass renders."""

    x: int
    y: int
    width: int
    height: int


def sensor_of(camera: Camera, samples: int, window: FilmWindow | None = None) -> Any:
    """A Mitsuba sensor at the origin. Mitsuba's x points left and y up: this function alone knows."""
    mi = mitsuba()
    axes = camera.world_from_camera
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = -axes[:, 0], -axes[:, 1], axes[:, 2]
    width, height = camera.size_px
    film: dict[str, Any] = {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgba",
        "component_format": "float32",
    }
    if window is not None:
        film |= {
            "crop_offset_x": window.x,
            "crop_offset_y": window.y,
            "crop_width": window.width,
            "crop_height": window.height,
        }
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": camera.hfov_deg,
            "fov_axis": "x",
            "near_clip": 1e-3,  # the identity pass starts at the camera itself
            "far_clip": 1e6,
            "to_world": mi.ScalarTransform4f(matrix),
            "film": film,
            "sampler": {"type": "multijitter", "sample_count": samples},
        }
    )


def load(scene: dict[str, Any]) -> Any:
    """Load a scene dictionary with many instances fast."""
    return mitsuba().load_dict({"type": "scene", **scene}, parallel=True, optimize=False)
