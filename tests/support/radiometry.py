"""Fluxes in a scene, ray by ray, and what its surfaces absorb: nothing of the cameras is used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.render import irradiance
from forestgen.render.irradiance import Source
from forestgen.render.light import emitters_of, envmap
from forestgen.render.variant import mitsuba
from forestgen.scene.colour import Channels
from forestgen.scene.spec import SceneSpec, Sky

Floats = NDArray[np.float64]
_REPLICATES = 16  # of which a mean is made, and its error


@dataclass(frozen=True)
class Mean:
    """A mean by channel with its standard error."""

    value: Floats  # (3,)
    error: Floats  # (3,)

    def __mul__(self, factor: Any) -> Mean:
        return Mean(self.value * factor, self.error * np.abs(factor))

    def __add__(self, other: Mean) -> Mean:
        return Mean(self.value + other.value, np.hypot(self.error, other.error))


def path_integrator(max_depth: int = -1, rr_depth: int = 8) -> Any:
    """The renderer's path tracer; without a limit by default, so that light is only lost to surfaces."""
    return mitsuba().load_dict({"type": "path", "max_depth": max_depth, "rr_depth": rr_depth})


def radiance(scene: Any, integrator: Any, origin_m: Floats, direction: Floats, seed: int) -> Floats:
    """(N, 3) one sample of the radiance that arrives at each of (N, 3) points, seen along (N, 3) directions."""
    mi = mitsuba()
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed)
    result = np.empty((len(origin_m), 3))
    for row, (o, d) in enumerate(zip(origin_m.tolist(), direction.tolist(), strict=True)):
        result[row] = integrator.sample(scene, sampler, mi.RayDifferential3f(mi.Ray3f(o, d)))[0]
    return result


def mean_of(samples: Floats) -> Mean:
    """Mean of (N, 3) independent samples."""
    return Mean(samples.mean(axis=0), samples.std(axis=0, ddof=1) / np.sqrt(len(samples)))


def even_numbers(count: int, dimensions: int, rng: np.random.Generator) -> Floats:
    """(N, D) in [0, 1): Roberts' R sequence, shifted at random; each number alone is uniform."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    step = root ** -np.arange(1.0, dimensions + 1)
    return np.asarray((rng.random(dimensions) + np.arange(count)[:, None] * step) % 1.0)


def cosine_directions(normal: Floats, uniform: Floats) -> Floats:
    """(N, 3) directions about (N, 3) unit normals, their density the cosine over pi, from (N, 2) numbers."""
    other = np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    along = np.cross(normal, other)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(normal, along)
    radius, azimuth = np.sqrt(uniform[:, :1]), uniform[:, 1:] * 2 * np.pi
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    return np.asarray(x * along + y * across + np.sqrt(1 - radius**2) * normal)


@dataclass(frozen=True)
class Square:
    """A level square about the z axis."""

    half_m: float
    z_m: float

    def points(self, uniform: Floats) -> Floats:
        """(N, 3) from (N, 2) numbers."""
        return np.column_stack([(2 * uniform - 1) * self.half_m, np.full(len(uniform), self.z_m)])


def flux_through(scene: Any, integrator: Any, square: Square, *, upward: bool, rays: int, seed: int) -> Mean:
    """Mean irradiance on a level square, of light that travels up, or down."""
    facing = np.array([0.0, 0.0, -1.0 if upward else 1.0])
    means = []
    for replicate in range(_REPLICATES):
        uniform = even_numbers(rays // _REPLICATES, 4, np.random.default_rng([seed, replicate]))
        direction = cosine_directions(np.tile(facing, (len(uniform), 1)), uniform[:, 2:])
        means.append(
            radiance(scene, integrator, square.points(uniform[:, :2]), direction, _REPLICATES * seed + replicate)
        )
    return mean_of(np.array(means).mean(axis=1)) * np.pi


def outgoing(scene: Any, integrator: Any, square: Square, towards: Floats, *, rays: int, seed: int) -> Mean:
    """Mean radiance of a level square, seen from a direction above it."""
    means = []
    for replicate in range(_REPLICATES):
        points = square.points(even_numbers(rays // _REPLICATES, 2, np.random.default_rng([seed, replicate])))
        direction = np.tile(-towards, (len(points), 1))
        means.append(radiance(scene, integrator, points, direction, _REPLICATES * seed + replicate).mean(axis=0))
    return mean_of(np.array(means))


def upper_sky(radiance_above: float = 1.0) -> dict[str, Any]:
    """An emitter: a sky of one radiance, black below the horizon."""
    image = np.zeros((512, 4, 3), dtype=np.float32)
    image[:256] = radiance_above  # rows lie at k pi / 511: none is the horizon itself
    return envmap(image)


@dataclass(frozen=True)
class Facets:
    """Triangles in the world; their normals are those of the side that faces are seen from."""

    corner_m: Floats  # (T, 3, 3)

    @property
    def normal_m2(self) -> Floats:
        """(T, 3) unit normals times areas."""
        a, b, c = np.moveaxis(self.corner_m, 1, 0)
        return np.asarray(np.cross(b - a, c - a) / 2)

    def points(self, uniform: Floats) -> tuple[Floats, Floats]:
        """(N, 3) places, evenly by area, and (N, 3) unit normals there, from (N, 3) numbers."""
        normal = self.normal_m2
        area = np.linalg.norm(normal, axis=1)
        total = np.cumsum(area)
        chosen = np.minimum(np.searchsorted(total, uniform[:, 0] * total[-1]), len(area) - 1)
        first, second = np.sqrt(uniform[:, 1:2]), uniform[:, 2:]
        a, b, c = np.moveaxis(self.corner_m[chosen], 1, 0)
        points = (1 - first) * a + first * (1 - second) * b + first * second * c
        return points, normal[chosen] / area[chosen, None]


def facets_of(spec: SceneSpec, rows: NDArray[np.intp], part: Part) -> Facets:
    """A part's surfaces, of some instances."""
    corners = []
    for row in rows:
        matrix = spec.instances.transform[row]
        for organ in spec.exemplars[int(spec.instances.exemplar[row])].organs:
            if organ.part is part:
                vertices = organ.mesh.vertices_m.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
                corners.append(vertices[organ.mesh.faces])
    return Facets(np.concatenate(corners))


def light_on(scene: Any, integrator: Any, facets: Facets, *, sides: int, rays: int, seed: int) -> Mean:
    """Power that falls on the upper side of facets, or on both sides."""
    area = float(np.linalg.norm(facets.normal_m2, axis=1).sum())
    total = Mean(np.zeros(3), np.zeros(3))
    for side in (1.0, -1.0)[:sides]:
        means = []
        for replicate in range(_REPLICATES):
            own = [seed, replicate, int(side > 0)]
            uniform = even_numbers(rays // (_REPLICATES * sides), 5, np.random.default_rng(own))
            points, normals = facets.points(uniform[:, :3])
            direction = cosine_directions(side * normals, uniform[:, 3:])
            number = 2 * (_REPLICATES * seed + replicate) + own[2]
            means.append(radiance(scene, integrator, points + side * normals * 1e-5, direction, number).mean(axis=0))
        total = total + mean_of(np.array(means)) * (np.pi * area)
    return total


def uniform_sky(irradiance: Spectrum) -> Source:
    """A sky that is equally bright in all directions, by its light on a level plane in W/m²/nm."""

    def emitter(channels: Channels) -> dict[str, Any]:
        radiance = [float(value) for value in channels.of_light(irradiance) / np.pi]
        return {"type": "constant", "radiance": {"type": "rgb", "value": radiance}, "sampling_weight": 0.0}

    # All light samples go to a lamp without light: paths find the sky by themselves. All directions of a flat surface
    # then see the same, and its image has no noise. (A scene of weight 0 in all is refused.)
    lamp = {"type": "point", "position": [0.0, 0.0, 0.0], "intensity": {"type": "rgb", "value": 0.0}}
    return Source("sky", irradiance, emitter, {"lamp": lamp}, roulette_from=64)


def lights(sky: Sky, channels: Channels) -> dict[str, dict[str, Any]]:
    """All lights of a cloudless scene by name."""
    return {name: emitter(channels) for name, emitter in emitters_of(sky).items()}


@contextmanager
def under_uniform_sky(spectrum: Spectrum | None) -> Iterator[None]:
    """Light meters and charts are lit by a uniform sky in place of the scene's own lights; None: by their own."""
    if spectrum is None:
        yield
        return
    with mock.patch.object(irradiance, "sources_of", return_value=[uniform_sky(spectrum)]):
        yield
