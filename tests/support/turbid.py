"""Leaves strewn at random in a layer: their meshes, and what theory says of them.

Theory takes leaves as infinitely small: light meets them at random wherever it has been before. Leaves of finite size
s in a layer of depth h differ: what comes back the way that it went in finds no leaf there (the hot spot). That changes
the reflectance by about s / h; for gaps it changes nothing, if the leaves' number is Poisson's and their places are
independent.

References
----------
Ross 1981, "The radiation regime and architecture of plant stands": the bi-Lambertian turbid medium.
Suits 1972; Kubelka and Munk 1931: the equations of two streams, which are exact for level leaves.
Nilson 1971, "A theoretical analysis of the frequency of gaps in plant stands".
Strebel, Goel and Ranson 1985; de Wit 1965: planophile and erectophile leaf angles, 2/pi (1 ± cos 2 theta).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec, Sky, Terrain

Floats = NDArray[np.float64]
Angles = Callable[[Floats], Floats]  # density of the leaf normal's zenith angle, (N,) rad in [0, pi/2]

SPHERICAL: Angles = np.sin
PLANOPHILE: Angles = lambda angle: 2 / np.pi * (1 + np.cos(2 * angle))  # noqa: E731
ERECTOPHILE: Angles = lambda angle: 2 / np.pi * (1 - np.cos(2 * angle))  # noqa: E731


@dataclass(frozen=True)
class Layer:
    """What a layer does with light from above, each shares of it."""

    reflected: Floats  # (...,)
    transmitted: Floats  # (...,) scattered or not

    def over(self, soil: Floats, below: Layer) -> Floats:
        """Reflectance over Lambertian soil; `below` is the layer for diffuse light from below."""
        return np.asarray(self.reflected + self.transmitted * soil * below.transmitted / (1.0 - soil * below.reflected))


def two_streams(leaf_area_index: float, reflectance: Floats, transmittance: Floats) -> Layer:
    """Level leaves: light of every direction is caught alike, so the equations of two fluxes are exact."""
    caught = 1.0 - transmittance
    rate = np.sqrt(np.maximum(caught**2 - reflectance**2, 1e-12))
    deep = reflectance / (caught + rate)
    once, twice = np.exp(-rate * leaf_area_index), np.exp(-2 * rate * leaf_area_index)
    return Layer(deep * (1 - twice) / (1 - deep**2 * twice), (1 - deep**2) * once / (1 - deep**2 * twice))


def facing(cosine: float, angle: Floats, azimuths: int = 720) -> tuple[Floats, Floats]:
    """Mean cosines on the upper and on the lower side of leaves of a zenith angle, (N,) each, over all azimuths.

    Of light that travels at `cosine` (of its zenith angle): the upper side is the one that it leaves.
    """
    azimuth = (np.arange(azimuths) + 0.5) * 2 * np.pi / azimuths
    sine = np.sqrt(1 - cosine**2)
    along = cosine * np.cos(angle)[:, None] + sine * np.sin(angle)[:, None] * np.cos(azimuth)
    return np.maximum(along, 0).mean(axis=1), np.maximum(-along, 0).mean(axis=1)


def projection(cosine: float, angles: Angles) -> float:
    """G: mean projection of a leaf's area along a direction."""
    angle, weight = _leaf_angles(angles)
    return float(np.sum(weight * sum(facing(cosine, angle))))


def discrete_ordinates(
    leaf_area_index: float, reflectance: float, transmittance: float, angles: Angles, streams: int = 12, steps: int = 12
) -> tuple[Floats, Layer, Layer]:
    """A layer of bi-Lambertian leaves by adding and doubling, fluxes averaged over azimuth.

    Returns
    -------
    cosines : (streams,) of directions of light.
    directional : (streams,) for light from each of them.
    diffuse : () for light equally from everywhere.
    """
    node, weight = np.polynomial.legendre.leggauss(streams)
    cosine, weight = (node + 1) / 2, weight / 2
    angle, share = _leaf_angles(angles)
    up = np.array([facing(c, angle) for c in cosine])  # (streams, 2, N); downward light swaps the sides
    caught = np.einsum("sin,n->s", up, share)
    same = np.einsum("sin,tin,n->st", up, up, share)  # leaves on the side that the light goes to
    other = np.einsum("sin,tin,n->st", up, up[:, ::-1], share)
    # From direction t to direction s, onward (both up or both down) or back, for a unit of leaf area.
    onward = 2 * (transmittance * same + reflectance * other)
    back = 2 * (reflectance * same + transmittance * other)
    thin = leaf_area_index / 2**steps
    scale = weight[None, :] * thin / cosine[:, None]
    transmit = np.diag(1 - caught * thin / cosine) + onward * scale
    reflect = back * scale
    for _ in range(steps):
        between = np.linalg.inv(np.eye(streams) - reflect @ reflect)
        reflect, transmit = reflect + transmit @ between @ reflect @ transmit, transmit @ between @ transmit
    # Columns: radiance out for radiance in. A unit of flux from direction t is radiance 1 / (2 mu w) there.
    flux = cosine * weight
    directional = Layer((flux @ reflect) / flux, (flux @ transmit) / flux)
    total = 2 * flux
    return cosine, directional, Layer(directional.reflected @ total, directional.transmitted @ total)


def _leaf_angles(angles: Angles, nodes: int = 48) -> tuple[Floats, Floats]:
    node, weight = np.polynomial.legendre.leggauss(nodes)
    angle = (node + 1) * np.pi / 4
    share = weight * angles(angle)
    return angle, share / share.sum()


def leaf_normals(count: int, angles: Angles | None, rng: np.random.Generator) -> Floats:
    """(N, 3) unit normals of random azimuth; without a distribution of angles all are level."""
    if angles is None:
        return np.tile([0.0, 0.0, 1.0], (count, 1))
    grid = np.linspace(0, np.pi / 2, 4001)
    density = angles(grid)
    cumulative = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    zenith = np.interp(rng.random(count), cumulative / cumulative[-1], grid)
    azimuth = rng.random(count) * 2 * np.pi
    return np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)], axis=1)


@dataclass(frozen=True)
class Leaves:
    """Square leaves in a slab over [0, width]² that repeats sideways."""

    centre_m: Floats  # (N, 3)
    along: Floats  # (N, 3) unit, an edge
    across: Floats  # (N, 3) unit, the other
    side_m: float
    width_m: float
    depth_m: float

    def mesh(self) -> Mesh:
        """Two triangles a leaf."""
        a, b = self.along * self.side_m / 2, self.across * self.side_m / 2
        corners = np.stack([self.centre_m + s * a + t * b for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))], axis=1)
        first = np.arange(len(corners))[:, None] * 4
        faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
        return Mesh(corners.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32))

    def crossings(self, foot_m: Floats, direction: Floats) -> NDArray[np.int64]:
        """(R,) leaves on the whole ray from (R, 2) places on the slab's floor, all in one upward direction."""
        normal = np.cross(self.along, self.across)
        count = np.zeros(len(foot_m), dtype=np.int64)
        for first in range(0, len(foot_m), 64):
            start = np.column_stack([foot_m[first : first + 64], np.zeros(len(foot_m[first : first + 64]))])
            level = start[:, None] + direction * (self.centre_m[:, 2] / direction[2])[:, None]
            gap = level - self.centre_m
            gap -= np.round(gap / self.width_m) * self.width_m * [1, 1, 0]
            gap -= direction * (np.sum(gap * normal, axis=-1) / (normal @ direction))[..., None]
            inside = (np.abs(np.sum(gap * self.along, axis=-1)) <= self.side_m / 2) & (
                np.abs(np.sum(gap * self.across, axis=-1)) <= self.side_m / 2
            )
            count[first : first + 64] = inside.sum(axis=1)
        return count


def strew(
    leaf_area_index: float,
    side_m: float,
    width_m: float,
    depth_m: float,
    angles: Angles | None,
    rng: np.random.Generator,
    *,
    exact: bool = False,
) -> Leaves:
    """Leaves at random; their number is Poisson's with the mean of the index, or `exact`."""
    mean = leaf_area_index * width_m**2 / side_m**2
    count = round(mean) if exact else int(rng.poisson(mean))
    normal = leaf_normals(count, angles, rng)
    along = np.cross(normal, rng.normal(size=(count, 3)))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    centre = rng.random((count, 3)) * [width_m, width_m, depth_m]
    return Leaves(centre, along, np.cross(normal, along), side_m, width_m, depth_m)


def tiled(leaves: Leaves, material: Material, tiles: int, ground: Terrain, camera: Camera) -> SceneSpec:
    """The slab repeated `tiles` x `tiles` times around the origin, an instance each."""
    exemplar = Exemplar("slab", (OrganMesh(Part.LEAF, "leaf", leaves.mesh()),), leaves.width_m, leaves.depth_m,
                        leaves.width_m, 0.0, 0.0)  # fmt: skip
    place = (np.arange(tiles) - tiles / 2) * leaves.width_m
    transform = np.zeros((tiles**2, 3, 4))
    transform[:, [0, 1, 2], [0, 1, 2]] = 1.0
    transform[:, 0, 3], transform[:, 1, 3] = (axis.ravel() for axis in np.meshgrid(place, place))
    return SceneSpec(
        exemplars=(exemplar,),
        materials={("slab", "leaf"): material},
        instances=Instances(
            np.zeros(tiles**2, dtype=np.uint32), transform, np.arange(1, tiles**2 + 1, dtype=np.uint32)
        ),
        terrain=ground,
        sky=Sky(60.0, 180.0, 3.0),
        clouds=None,
        cameras=(camera,),
    )
