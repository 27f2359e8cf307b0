"""Barks of a stem by height, and what grows on it: moss, algae, by height and weather side.

A stem's surface is cut along contours, so that each material has a mesh of its own, with fine triangles where the
contours are.

- A bark zone begins where the share of the height, which noise makes uneven, passes between its two shares. Between
  them ever larger parts of the bark below have the zone's bark, as under a cover; from far there is one edge.
- A cover grows where its share s at the height z, on the side at the azimuth a, is above a noise that is even in 0..1:

      s = at_foot exp(-z / fades_m) + weather exp(-z / weather_fades_m) ((1 + cos(a - weather side)) / 2)^2

  times a number of the stem's own. So s of the surface there bears it: thinnest at the edge of a patch, denser where
  s is above the noise by `_DENSER`. All are the bark's own texture with the cover's colour in parts of it
  (plants/bark/texture.py); `covered_name` names them.

Mosses grow highest on the side from which rain comes and at the foot, where stems are moist longest (Barkman 1958,
Phytosociology and Ecology of Cryptogamic Epiphytes, chapters on exposure and height). Shares are ours.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from forestgen.core.randomness import child_rng
from forestgen.geometry.contours import bisected, cut, edge_lengths_m
from forestgen.geometry.mesh import Bools, Floats, Ints, Mesh
from forestgen.plants.exemplar import OrganMesh
from forestgen.recipe.wood import BarkZone, Cover, Wood

COVERED = "+"  # in the name of a bark under a cover
LEVELS = (0.12, 0.45, 0.88)  # share of a covered bark's texture that has the cover's colour, from thin to dense
_DENSER = (0.0, 0.1, 0.25)  # s above the noise, of each
_BLENDS = (-0.5, -0.17, 0.17, 0.5)  # of the way between a zone's shares: where each of `LEVELS`, and the zone, begins
_LEAST_SHARE = 0.03  # of a cover
_UNLIKE = 0.5  # standard deviation of the logarithm of what stems bear
_LEAST_RADIUS_M = 0.03  # of a stem that bears anything
EDGE_M = 0.08  # of the finest triangles, at the ground
_COARSER_M = 2.0  # height at which they are twice as large
_ROUNDS = 10  # of refinement
_WAVES_M = (1.6, 0.8, 0.4, 0.2)  # lengths of the noise's waves; shorter ones are weaker
_ACROSS = 0.6  # of the waves' length up the stem, round it
_ZONE_NOISE = 0.25  # of the noise in a zone's beginning
_NEAR_ZONE, _NEAR_COVER = 0.35, 0.08  # of a contour, within which noise between vertices may cross it


def covered_name(bark: str, cover: str, level: int) -> str:
    """Name of a bark under a cover, of `LEVELS`."""
    return f"{bark}{COVERED}{cover}{COVERED}{level}"


def surfaced(
    organ: OrganMesh, wood: Wood, base_radius_m: float, pixel_m: float, tile_m: tuple[float, float]
) -> list[OrganMesh]:
    """A stem's surface in pieces of one material each; from far without covers.

    `base_radius_m`: of the stem at its foot, by which stems differ. `tile_m`: of its bark's texture, see `sweep_tubes`.
    """
    if base_radius_m < _LEAST_RADIUS_M:
        return [organ]
    waves = _Waves(round(1e6 * base_radius_m))
    edge_m, top_m = max(EDGE_M, 0.5 * pixel_m), float(organ.mesh.vertices_m[:, 2].max())
    girth_m = 2.0 * np.pi * base_radius_m
    stretched = girth_m / (tile_m[0] * max(1, round(girth_m / tile_m[0])))
    pieces = [_shifted(organ, child_rng(waves.seed, "texture").random(2), stretched)]
    for zone in wood.bark_zones:
        field = _ZoneField(zone, waves, top_m)
        found: list[OrganMesh] = []
        for one in pieces:
            steps = {} if pixel_m > 0.0 or COVERED in one.material else _steps(one.material, zone.material, _BLENDS)
            last = _BLENDS[-1] if steps else 0.0
            found += _layered(one, field, {**steps, zone.material: last}, edge_m, edge_m)
        pieces = [_tiled(one, tile_m, zone.tile_m) if one.material == zone.material else one for one in found]
    if pixel_m > 0.0:
        return pieces
    for k, cover in enumerate(wood.covers):
        grows, bare = _CoverField(cover, waves, float(k)), pieces
        pieces = [one for one in bare if COVERED in one.material]
        for one in bare:
            if COVERED not in one.material:
                pieces += _layered(one, grows, _steps(one.material, cover.material, _DENSER), edge_m, np.inf)
    return pieces


def _steps(bark: str, over: str, begins: tuple[float, ...]) -> dict[str, float]:
    """Names of a bark that something covers ever more of, and the value of the field at which each begins."""
    return {covered_name(bark, over, level): begins[level] for level in range(len(LEVELS))}


def _layered(organ: OrganMesh, field: Field, steps: dict[str, float], edge_m: float, later_m: float) -> list[OrganMesh]:
    """The surface in pieces of other materials, each where the field is above its value.

    `edge_m`, `later_m`: edges of the finest triangles at the first contour, and at the others.
    """
    pieces, inside = [], organ
    for k, (name, above) in enumerate(steps.items()):
        *outside, inside = split(inside, _Raised(field, above), later_m if k else edge_m, name)
        pieces += outside
        if inside.material != name:
            break
    return [*pieces, inside]


class _Waves:
    """Smooth noise of mean 0 and deviation 1."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        rng = child_rng(seed, "stem surface")
        length = np.repeat(_WAVES_M, 4)
        way = rng.normal(size=(len(length), 3))
        way *= (2.0 * np.pi / length / np.linalg.norm(way, axis=1))[:, None]
        self._way = way * np.array([1.0 / _ACROSS, 1.0 / _ACROSS, 1.0])
        self._phase = rng.uniform(0.0, 2.0 * np.pi, len(length))
        self._size = length**0.35 / np.sqrt(0.5 * np.sum(length**0.7))

    def amount(self, shift: float) -> float:
        """How much a stem bears, over the mean; `shift`: of another cover."""
        return float(np.exp(child_rng(self.seed, "cover", round(shift)).normal(-0.5 * _UNLIKE**2, _UNLIKE)))

    def at(self, mesh: Mesh, shift: float) -> Floats:
        """(V,) at a mesh's vertices; `shift`: another noise."""
        return np.asarray(
            np.sin(mesh.vertices_m.astype(np.float64) @ self._way.T + self._phase * (1.0 + shift)) @ self._size
        )


class _ZoneField:
    """Above 0 where another bark is."""

    near = _NEAR_ZONE

    def __init__(self, zone: BarkZone, waves: _Waves, top_m: float) -> None:
        low, high = zone.above or zone.below or (0.0, 0.0)
        self._sign, self._waves = (1.0 if zone.above else -1.0), waves
        self._middle_m, self._wide_m = 0.5 * (low + high) * top_m, max((high - low) * top_m, 1e-3)

    def at(self, mesh: Mesh) -> Floats:
        along = (mesh.vertices_m[:, 2] - self._middle_m) / self._wide_m
        return np.asarray(self._sign * (along + _ZONE_NOISE * self._waves.at(mesh, 7.0)))


class _CoverField:
    """Above 0 where a cover grows: its share less an even noise."""

    near = _NEAR_COVER

    def __init__(self, cover: Cover, waves: _Waves, shift: float) -> None:
        self._cover, self._waves, self._shift = cover, waves, shift
        self._amount = waves.amount(shift)

    def at(self, mesh: Mesh) -> Floats:
        assert mesh.normals is not None  # wood has
        cover, height_m = self._cover, np.maximum(mesh.vertices_m[:, 2].astype(np.float64), 0.0)
        east, north = mesh.normals[:, :2].T.astype(np.float64)
        side = np.radians(cover.weather_side_deg)
        facing = (east * np.sin(side) + north * np.cos(side)) / np.maximum(np.hypot(east, north), 1e-9)
        share = cover.at_foot * np.exp(-height_m / cover.fades_m)
        share += cover.weather * np.exp(-height_m / cover.weather_fades_m) * (0.5 + 0.5 * facing) ** 2
        share *= self._amount
        even = 1.0 / (1.0 + np.exp(-1.702 * self._waves.at(mesh, self._shift)))  # of a normal number
        return np.where(share < _LEAST_SHARE, -1.0, share - even)


class _Raised:
    """The same field, less a value."""

    def __init__(self, field: Field, by: float) -> None:
        self.near, self._field, self._by = field.near, field, by

    def at(self, mesh: Mesh) -> Floats:
        return np.asarray(self._field.at(mesh) - self._by)


class Field(Protocol):
    """A value on a surface."""

    @property
    def near(self) -> float:
        """How near to 0 it is, at the corners of a triangle, where it may be 0 between them."""
        ...

    def at(self, mesh: Mesh) -> Floats:
        """(V,) at a mesh's vertices."""
        ...


def split(organ: OrganMesh, field: Field, edge_m: float, material: str) -> list[OrganMesh]:
    """The surface, and what has another material where the field is above 0."""
    mesh, origin = organ.mesh, np.arange(organ.mesh.triangles)
    value = field.at(mesh)
    for _ in range(_ROUNDS):
        corners = mesh.faces.astype(np.int64)
        most_m = edge_m * (1.0 + np.maximum(mesh.vertices_m[corners[:, 0], 2], 0.0) / _COARSER_M)
        coarse = _near(mesh, value, field.near)
        coarse[coarse] = edge_lengths_m(mesh, corners[coarse]).max(axis=1) > most_m[coarse]
        if not coarse.any():
            break
        mesh, of = bisected(mesh, coarse)
        origin = origin[of]
        value = np.append(value, field.at(_vertices_from(mesh, len(value))))
    (outside, outer), (inside, inner) = cut(mesh, value)
    if not inside.triangles:
        return [organ]
    made = [(outside, origin[outer], organ.material), (inside, origin[inner], material)]
    return [_piece(organ, one, faces, name) for one, faces, name in made if one.triangles]


def _vertices_from(mesh: Mesh, first: int) -> Mesh:
    """The last vertices of a mesh, without faces."""
    assert mesh.normals is not None  # wood has
    return Mesh(mesh.vertices_m[first:], mesh.faces[:0], mesh.normals[first:])


def _piece(organ: OrganMesh, mesh: Mesh, faces: Ints, material: str) -> OrganMesh:
    mark = None if organ.mark is None else organ.mark[faces]
    return replace(organ, mesh=mesh, material=material, mark=mark)


def _shifted(organ: OrganMesh, by: Floats, stretched: float) -> OrganMesh:
    """The surface with its texture elsewhere, so that no two stems show the same plates at their feet.

    `stretched`: width of the texture's repeat on the stem over its own. Its height is multiplied by it too: plates keep
    their shape, and thin stems have small ones.
    """
    uv, scale = organ.mesh.uv, np.array([1.0, 1.0 / stretched])
    if uv is None:
        return organ
    return replace(organ, mesh=replace(organ.mesh, uv=(uv * scale + by).astype(np.float32)))


def _tiled(organ: OrganMesh, old_m: tuple[float, float], new_m: tuple[float, float] | None) -> OrganMesh:
    """The surface with texture coordinates for another repeat: round the stem a whole number of times as many."""
    uv = organ.mesh.uv
    if new_m is None or uv is None:
        return organ
    factor = np.array([max(1.0, round(old_m[0] / new_m[0])), old_m[1] / new_m[1]], dtype=np.float32)
    return replace(organ, mesh=replace(organ.mesh, uv=uv * factor))


def _near(mesh: Mesh, value: Floats, within: float) -> Bools:
    """(F,) faces that a contour may pass through."""
    of = value[mesh.faces.T]
    return np.asarray((of.min(axis=0) < within) & (of.max(axis=0) > -within))
