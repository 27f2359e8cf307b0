"""SceneSpec -> Mitsuba scenes.

Everything is shifted so that the camera's foot is the origin: the renderer lifts ray origins by about 9e-5 of their
distance from the origin, which far from it brightens thin leaves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.render.surfaces import Paints
from forestgen.render.variant import mitsuba
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera, SceneSpec


def origin_of(camera: Camera) -> NDArray[np.float64]:
    """(3,) metres, world: the point that the renderer's frame has as its origin for `camera`."""
    return np.asarray(camera.position_m, dtype=np.float64)


def ray_corners_m(camera: Camera) -> NDArray[np.float64]:
    """(N, 3) metres, world: where `camera`'s rays start lies between these places.

    Four corners of a plane if its rays are parallel, otherwise the one place of the camera.
    """
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
    fill(parameters, "vertex_positions", vertices)
    fill(parameters, "faces", mesh.faces)
    if normals is not None:
        fill(parameters, "vertex_normals", normals)
    if uv is not None:
        fill(parameters, "vertex_texcoords", uv)
    parameters.update()
    return result


def fill(parameters: Any, key: str, values: NDArray[Any]) -> None:
    """Give an array among a Mitsuba object's parameters other values, as many as it has; `update` is the caller's.

    In a scalar variant its `numpy` is the renderer's own memory: an assignment goes element by element there, a
    hundred times slower.
    """
    flat = np.ascontiguousarray(values).ravel()
    if mitsuba().variant().startswith("scalar"):
        np.copyto(parameters[key].numpy(), flat)
        parameters.set_dirty(key)
    else:
        parameters[key] = flat


def transform_of(matrix: NDArray[np.float64], shift_m: NDArray[np.float64]) -> Any:
    """A Mitsuba transform of a (3, 4) matrix, in the frame shifted by `shift_m`."""
    full = np.eye(4)
    full[:3] = matrix
    full[:3, 3] -= shift_m
    return mitsuba().ScalarTransform4f(full)


def plants_dict(spec: SceneSpec, origin_m: NDArray[np.float64], paints: Paints | None) -> dict[str, Any]:
    """Shape groups and instances; without paints they have geometry only.

    Instance i has the key ``instance-i``, so tables can follow its order.
    """
    scene: dict[str, Any] = {}
    used = np.unique(spec.instances.exemplar)
    for index in used:
        exemplar = spec.exemplars[index]
        group: dict[str, Any] = {"type": "shapegroup"}
        for number, organ in enumerate(exemplar.organs):
            bsdf = None
            if paints is not None:
                material = spec.materials[exemplar.species, organ.material]
                bsdf = paints.plant(organ.part, material, has_uv=organ.mesh.uv is not None)
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


def scene_dict(spec: SceneSpec, origin_m: NDArray[np.float64], paints: Paints) -> dict[str, Any]:
    """Plants on their terrain, without light."""
    scene = plants_dict(spec, origin_m, paints)
    terrain = to_mesh(spec.terrain.mesh, paints.ground(spec.terrain), origin_m, "terrain")
    terrain.add_attribute("vertex_far_share", 1, spec.terrain.far_share)
    if spec.terrain.wet is not None:
        terrain.add_attribute("vertex_wet_share", 1, spec.terrain.wet.share)
    scene["terrain"] = terrain
    return scene


def load(scene: dict[str, Any]) -> Any:
    """Load a scene dictionary with many instances fast."""
    return mitsuba().load_dict({"type": "scene", **scene}, parallel=True, optimize=False)
