"""A post of bark that fills a picture, for tests of its texture and relief."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import SurfaceTexture
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec
from support.scenes import plain_ground, scattered_scene

REFLECTANCE = (0.33, 0.24, 0.15)
TILE_M = (0.1, 0.1)


def cylinder(sides: int = 64, uv: bool = True) -> Mesh:
    """An open cylinder of radius 0.5 and height 2 about the z axis; u runs anticlockwise seen from above."""
    angle = np.arange(sides + 1) * 2 * np.pi / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides + 1)], axis=1)
    vertices = np.concatenate([ring * 0.5, ring * 0.5 + [0, 0, 2]])
    repeats = np.round(np.pi / TILE_M[0])
    places = [np.stack([angle / (2 * np.pi) * repeats, np.full(sides + 1, v)], axis=1) for v in (0, 2 / TILE_M[1])]
    k = np.arange(sides)
    low = np.stack([k, k + 1, k + sides + 2], axis=1)
    high = np.stack([k, k + sides + 2, k + sides + 1], axis=1)
    return Mesh(
        vertices.astype(np.float32),
        np.concatenate([low, high]).astype(np.uint32),
        np.concatenate([ring, ring]).astype(np.float32),
        np.concatenate(places).astype(np.float32) if uv else None,
    )


def post_scene(material: Material, uv: bool = True, turn_deg: float = 0.0, part: Part = Part.TRUNK) -> SceneSpec:
    """One cylinder, seen from the south so that it fills the picture's width."""
    post = Exemplar(
        species="post",
        organs=(OrganMesh(part, "bark", cylinder(uv=uv)),),
        radius_m=1.0,
        height_m=2.0,
        crown_width_m=1.0,
        leaf_area_m2=0.0,
        wood_volume_m3=1.0,
    )
    turn = np.radians(turn_deg)
    transform = np.array([[np.cos(turn), -np.sin(turn), 0, 0], [np.sin(turn), np.cos(turn), 0, 0], [0, 0, 1, 0]])
    eye = (0.0, -6.0, 1.0)
    return replace(
        scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-1.0, 1.0)),
        exemplars=(post,),
        materials={("post", "bark"): material},
        instances=Instances(np.zeros(1, np.uint32), transform[None], np.ones(1, np.uint32)),
        cameras=(Camera("main", eye, look_at(eye, (0.0, 0.0, 1.0)), (24, 24), 8.0),),
    )


def leaning_texture(lean: tuple[float, float] = (0.0, 0.0)) -> SurfaceTexture:
    """One colour; the height rises along u and v by `lean` everywhere but at the seam."""
    u, v = np.meshgrid((np.arange(64) + 0.5) / 64 * TILE_M[0], (np.arange(64) + 0.5) / 64 * TILE_M[1])
    height = (lean[0] * u + lean[1] * v).astype(np.float32)
    return SurfaceTexture(np.broadcast_to(np.array(REFLECTANCE, np.float32), (64, 64, 3)).copy(), height, TILE_M)
