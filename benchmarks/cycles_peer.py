"""Blender Cycles as a peer of benchmarks/radiance.py: runs cycles_scene.py in a Python that has bpy."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.light import SUN_RADIUS_DEG, sky_map, sun_irradiance
from forestgen.render.surfaces import LEAFLIKE, sides_of
from forestgen.scene.colour import RGB
from forestgen.scene.spec import Camera, SceneSpec

WAYS = tuple((tree, sky) for tree in ("flat", "tree") for sky in ("sampled", "found"))  # see cycles_scene.py
Floats = NDArray[np.float64]


class Cycles:
    """Blender's renderer in a process of its own."""

    def __init__(self, python: str, folder: Path, scene: dict[str, Any]) -> None:
        np.savez(folder / "scene.npz", **scene)
        self._picture = folder / "picture.npy"
        environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
        self._child = subprocess.Popen(
            [python, str(Path(__file__).with_name("cycles_scene.py")), str(folder / "scene.npz")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        self.ready = self._reply()

    def _reply(self) -> str:
        assert self._child.stdout
        for line in self._child.stdout:
            if line.startswith("REPLY "):
                return line.removeprefix("REPLY ").strip()
        raise RuntimeError("Blender ended without an answer")

    def take(self, samples: int, seed: int, way: tuple[str, str]) -> tuple[Floats, float]:
        assert self._child.stdin
        print(samples, seed, *way, self._picture, file=self._child.stdin, flush=True)
        seconds = float(self._reply())
        return np.load(self._picture).astype(np.float64), seconds

    def end(self) -> None:
        assert self._child.stdin
        self._child.stdin.close()
        self._child.wait()


def scene_of(spec: SceneSpec, camera: Camera) -> dict[str, Any]:
    """Arrays for cycles_scene.py: a plain scene, the camera's place as the origin."""
    kinds: dict[tuple[tuple[str, str], bool], int] = {}
    arrays: dict[str, Any] = {}
    for key in np.unique(spec.instances.exemplar):
        exemplar = spec.exemplars[key]
        vertices, faces, owner, first = [], [], [], 0
        for organ in exemplar.organs:
            kind = ((exemplar.species, organ.material), organ.part in LEAFLIKE)
            number = kinds.setdefault(kind, len(kinds))
            vertices.append(organ.mesh.vertices_m)
            faces.append(organ.mesh.faces.astype(np.int32) + first)
            owner.append(np.full(len(organ.mesh.faces), number, dtype=np.int32))
            first += len(organ.mesh.vertices_m)
        arrays[f"v{key}"] = np.concatenate(vertices, dtype=np.float32)
        arrays[f"f{key}"], arrays[f"m{key}"] = np.concatenate(faces), np.concatenate(owner)
    sides = [sides_of(spec.materials[key], RGB) for key, _ in kinds]
    origin = np.asarray(camera.position_m)
    transform = spec.instances.transform.copy()
    transform[:, :, 3] -= origin
    return arrays | {
        "r": np.array([side.matt for side in sides]),
        "t": np.array([side.through * leaf for side, (_, leaf) in zip(sides, kinds, strict=True)]),
        "exemplar": spec.instances.exemplar,
        "transform": transform,
        "ground": np.array(spec.terrain.mean_colour),
        "ground_v": (spec.terrain.mesh.vertices_m - origin).astype(np.float32),
        "ground_f": spec.terrain.mesh.faces.astype(np.int32),
        "sky": sky_map(spec.sky, RGB),
        "sun_irradiance": sun_irradiance(spec.sky, RGB),
        "sun_angle": np.radians(2 * SUN_RADIUS_DEG),
        "to_sun": spec.sky.to_sun,
        "world_from_camera": camera.world_from_camera,
        "hfov": np.radians(camera.hfov_deg),
        "size_px": np.array(camera.size_px),
    }
