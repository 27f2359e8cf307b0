"""SceneSpec -> Mitsuba scenes.

Everything is shifted so that the camera's foot is the origin: the renderer lifts ray origins by about 9e-5 of their
distance from the origin, which far from it brightens thin leaves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import mi
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera, SceneSpec


def origin_of(camera: Camera) -> NDArray[np.float64]:
    """(3,) metres, world: the point that the renderer's frame has as its origin for `camera`."""
    return np.asarray(camera.position_m, dtype=np.float64)


def ray_corners_m(camera: Camera) -> NDArray[np.float64]:
    """(N, 3) metres, world: `camera`'s rays start between these: four of a plane of parallel rays, or its place."""
    place = origin_of(camera)
    if not projection_of(camera).is_parallel:
        return place[None]
    half = camera.width_m / 2 * np.array([1.0, camera.size_px[1] / camera.size_px[0]])
    corners = np.array([[x, y] for x in (-1, 1) for y in (-1, 1)]) * half
    return np.asarray(place + corners @ camera.world_from_camera[:, :2].T)


def to_mesh(
    mesh: Mesh, bsdf: Any | None = None, offset_m: NDArray[np.float64] | None = None, name: str = "mesh"
) -> Any:
    """A Mitsuba mesh of the current variant; without a `bsdf` it has geometry only."""
    properties = mi.Properties()
    vertices = mesh.vertices_m if offset_m is None else (mesh.vertices_m - offset_m).astype(np.float32)
    arrays: dict[str, NDArray[Any]] = {"vertex_positions": vertices, "faces": mesh.faces}
    if bsdf is not None:
        properties["mesh_bsdf"] = bsdf
        shading = {"vertex_normals": mesh.normals, "vertex_texcoords": mesh.uv}
        arrays |= {key: values for key, values in shading.items() if values is not None}
    result = mi.Mesh(
        name,
        vertex_count=len(vertices),
        face_count=len(mesh.faces),
        has_vertex_normals="vertex_normals" in arrays,
        has_vertex_texcoords="vertex_texcoords" in arrays,
        props=properties,
    )
    parameters = mi.traverse(result)
    for key, values in arrays.items():
        fill(parameters, key, values)
    parameters.update()
    return result


def fill(parameters: Any, key: str, values: NDArray[Any]) -> None:
    """Give an array among a Mitsuba object's parameters other values, as many as it has; `update` is the caller's.

    In a scalar variant its `numpy` is the renderer's own memory: an assignment goes element by element there, a
    hundred times slower.
    """
    flat = np.ascontiguousarray(values).ravel()
    if mi.variant().startswith("scalar"):
        np.copyto(parameters[key].numpy(), flat)
        parameters.set_dirty(key)
    else:
        parameters[key] = flat


def plants_dict(spec: SceneSpec, origin_m: NDArray[np.float64], bsdfs: SpectralBsdfs | None) -> dict[str, Any]:
    """Shape groups and instances, ``instance-i`` the i-th; without BSDFs they have geometry only."""
    scene: dict[str, Any] = {}
    used = np.unique(spec.instances.exemplar)
    for index in used:
        exemplar = spec.exemplars[index]
        group: dict[str, Any] = {"type": "shapegroup"}
        for number, organ in enumerate(exemplar.organs):
            bsdf = None
            if bsdfs is not None:
                material = spec.materials[exemplar.species, organ.material]
                bsdf = bsdfs.plant(organ.part, material, has_uv=organ.mesh.uv is not None)
            group[f"organ-{number:02d}"] = to_mesh(organ.mesh, bsdf, name=f"{exemplar.species}-{number}")
        scene[f"exemplar-{index}"] = group
    reference = {int(index): {"type": "ref", "id": f"exemplar-{index}"} for index in used}
    matrix = np.tile(np.eye(4), (len(spec.instances), 1, 1))
    matrix[:, :3] = spec.instances.transform
    matrix[:, :3, 3] -= origin_m
    transform_of = mi.ScalarTransform4f
    for row, index in enumerate(spec.instances.exemplar.tolist()):
        place = transform_of(matrix[row])
        scene[f"instance-{row}"] = {"type": "instance", "to_world": place, "exemplar": reference[index]}
    return scene


def scene_dict(spec: SceneSpec, origin_m: NDArray[np.float64], bsdfs: SpectralBsdfs) -> dict[str, Any]:
    """Plants on their terrain, without light."""
    scene = plants_dict(spec, origin_m, bsdfs)
    terrain = to_mesh(spec.terrain.mesh, bsdfs.ground(spec.terrain), origin_m, "terrain")
    terrain.add_attribute("vertex_far_share", 1, spec.terrain.far_share)
    if spec.terrain.wet is not None:
        terrain.add_attribute("vertex_wet_share", 1, spec.terrain.wet.share)
    for index, patch in enumerate(spec.terrain.overlays):
        terrain.add_attribute(f"vertex_patch_share_{index}", 1, patch.share)
    scene["terrain"] = terrain
    return scene


def load(scene: dict[str, Any]) -> Any:
    """Load a scene dictionary with many instances fast."""
    return mi.load_dict({"type": "scene", **scene}, parallel=True, optimize=False)
