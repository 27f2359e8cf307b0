"""Blocks of a site, side by side to the horizon: which stands where, on what plane, and the meshes of far ones.

A place outside has, in repeat, the block that lies there when the site is laid side by side; in forest one drawn at
random, turned about its middle by right angles. Beyond `far_m` blocks are parts of squares of about `SQUARE_M`, where a
camera looks, up to `WOODS_M`: one mesh each, or, where the ground is uneven as seen from the site, block by block.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Floats
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.far_mesh import far_mesh
from forestgen.scene.ground_view import in_view
from forestgen.scene.spec import Camera, Instances
from forestgen.scene.terrain import HeightField, smooth_step

WOODS_M, SQUARE_M, SQUARE_VARIANTS, UNEVEN_SEEN = 6000.0, 160.0, 2, 0.004
MOST_BLOCKS_BEYOND = 10_000  # the nearest, where hills of more than about 150 m would need more
# Stands begin so far from the site, over so many metres; a share of the land of erfc(CLEAR / sqrt 2) / 2 is clear.
STANDS_FROM_M, _STANDS_OVER_M, CLEAR, _MEAN_HEIGHT, _HEIGHT_SD = 250.0, 150.0, 1.6, 0.88, 0.2
_STAND_WAVES, _SHORTEST_M, _LONGEST_M = 5, 280.0, 800.0
_PROBES = np.linspace(-0.5, 0.5, 5)  # along a block, where the ground is looked up
_BARRED_M = 0.8  # between places where it is asked for paths and water

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class FarBlock:
    """Plants of a block of the site, or of a square of such blocks, as one mesh, at all places where it stands."""

    rows: Rows  # (K,) of the site's instances
    xy_m: Floats  # (K, 2) their feet from the middle
    turn: Rows  # (K,) right angles by which they are turned
    transform: Floats  # (M, 3, 4) of the copies
    wide: bool = False  # a square of blocks, far away

    def mesh(self, plants: Instances, thin: Mapping[int, Exemplar]) -> Exemplar:
        which, transform = plants.exemplar[self.rows], plants.transform[self.rows]
        transform[:, :2, :3] = turns(self.turn) @ transform[:, :2, :3]
        transform[:, :2, 3] = self.xy_m
        transform[:, 2, 3] = 0.0  # feet are on the ground, which the copies' transforms know
        return far_mesh((thin[one], transform[which == one]) for one in np.unique(which).tolist())


@dataclass(frozen=True)
class Stands:
    """Stands of several heights and clearings in the land around a site: two sums of waves that are near Gaussian."""

    wave_per_m: Floats  # (2, W, 2) of heights, of clearings
    phase: Floats  # (2, W)

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Stands:
        shape = 2, _STAND_WAVES
        turn, length_m = 2.0 * np.pi * rng.random(shape), rng.uniform(_SHORTEST_M, _LONGEST_M, shape)
        wave = 2.0 * np.pi / length_m[..., None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        return cls(wave, 2.0 * np.pi * rng.random(shape))

    def relative_height(self, x_m: Floats, y_m: Floats, away_m: Floats) -> Floats:
        """(N,) height of plants at (N,) points so far from the site, by those of the site; 0 in clearings."""
        at = np.stack([x_m, y_m], axis=-1)
        waves = np.sin(self.wave_per_m @ at.T + self.phase[..., None])
        height, clear = np.sqrt(2.0 / _STAND_WAVES) * waves.sum(axis=1)
        far = smooth_step((away_m - STANDS_FROM_M) / _STANDS_OVER_M)
        tall = 1.0 + far * (np.clip(_MEAN_HEIGHT + _HEIGHT_SD * height, 0.4, 1.15) - 1.0)
        return np.where(far * clear > CLEAR, 0.0, tall)


@dataclass(frozen=True)
class Lattice:
    """Blocks side by side from the site to the horizon."""

    side_m: Floats  # (2,) of a block
    height: HeightField
    rng: np.random.Generator | None  # None: they repeat
    stands: Stands | None = None  # None: all are as the site

    @property
    def count(self) -> Rows:
        """(2,) along the sides of the site."""
        return np.round(np.asarray(self.height.size_m) / self.side_m).astype(np.intp)

    def drawn(self, at: Rows) -> tuple[Rows, Rows]:
        """Of (B, 2) places the block of the site that stands there, (B, 2), and its turn, (B,) right angles."""
        if self.rng is None:
            return at % self.count, np.zeros(len(at), dtype=np.intp)
        return self.rng.integers(self.count, size=at.shape), self.turned(len(at), self.side_m)

    def turned(self, count: int, side_m: Floats) -> Rows:
        """(B,) random right angles of blocks; half turns of those that are no squares."""
        if self.rng is None:
            return np.zeros(count, dtype=np.intp)
        turn = self.rng.integers(4, size=count)
        return turn if np.isclose(*side_m) else turn // 2 * 2

    def relative_height(self, at: Rows, many: Rows | int) -> Floats:
        """(B,) height of plants of blocks, or of squares of `many`, by those of the site; 0 in clearings."""
        if self.stands is None:
            return np.ones(len(at))
        x, y = ((at + 0.5) * many * self.side_m).T
        return self.stands.relative_height(x, y, self.height.distance_m(x, y))

    def planes(self, at: Rows, many: Rows | int) -> tuple[Floats, Floats]:
        """(B, 3) rise east and north and height at the middle of the ground's mesh in blocks, or in squares of `many`
        along their sides; (B,) how far it is from that.
        """
        side = many * self.side_m
        middle_m = (at + 0.5) * side
        x, y = (one.ravel() for one in np.meshgrid(_PROBES * side[0], _PROBES * side[1]))
        z = self.height.on_mesh(middle_m[:, :1] + x, middle_m[:, 1:] + y)
        plane = np.stack([z @ x / (x @ x), z @ y / (y @ y), z.mean(axis=1)], axis=1)
        miss = np.abs(z - plane @ np.stack([x, y, np.ones(len(x))]))
        return plane, miss.max(axis=1)

    def barred(self, at: Rows) -> Floats:
        """(B,) share of blocks on which no plant can stand."""
        if self.height.fine_m2 == 0.0:
            return np.zeros(len(at))
        inside = [(np.arange(n) + 0.5) / n for n in np.ceil(self.side_m / _BARRED_M).astype(np.intp)]
        x, y = (one.ravel() for one in np.meshgrid(*inside))
        shares = [self.height.barred(*((block + np.column_stack([x, y])) * self.side_m).T).mean() for block in at]
        return np.array(shares)


@dataclass(frozen=True)
class Blocks:
    """The plants of the site's blocks."""

    rows: Rows  # (N,)
    cell: Rows  # (N, 2) the block of each
    from_middle_m: Floats  # (N, 2) from the block's middle

    def of(self, index: Sequence[int]) -> tuple[Rows, Floats]:
        here = (self.cell == index).all(axis=1)
        return self.rows[here], self.from_middle_m[here]


@dataclass(frozen=True)
class Beyond:
    """Where there is forest beyond the far blocks, as cameras see it."""

    lattice: Lattice
    many: Rows  # (2,) blocks along the sides of a square
    at: Rows  # (B, 2) blocks of squares on uneven ground
    own: Rows
    turn: Rows
    plane: Floats  # (B, 3)
    transform: Floats  # (S, 3, 4) of squares
    variant: Rows  # (S,)

    @classmethod
    def of(cls, lattice: Lattice, far_m: float, top_m: float, cameras: Sequence[Camera]) -> Beyond:
        """`far_m`: distance from the site that other blocks reach. `top_m`: of the tallest plant."""
        side, count = lattice.side_m, lattice.count
        many = count * np.maximum(np.round(SQUARE_M / (side * count)), 1).astype(np.intp)
        # Square (0, 0) holds the site; distances to it are a little less than those to the site.
        at, apart = copied_blocks(many * side, np.ones(2, dtype=np.intp), WOODS_M if cameras else 0.0)
        plane, miss_m = lattice.planes(at, many)
        whole = (apart >= far_m) & (miss_m < UNEVEN_SEEN * apart)
        variant = np.arange(len(at)) % (1 if lattice.rng is None else SQUARE_VARIANTS)
        turn = lattice.turned(len(at), many * side)
        middle, radius_m = (at + 0.5) * many * side, 0.5 * float(np.hypot(*(many * side))) + top_m
        relative_height = lattice.relative_height(at, many)
        seen = in_view(cameras, np.column_stack([middle, plane[:, 2]]), radius_m)
        inner = _grid(*(np.arange(one) for one in many))
        split = np.concatenate([inner, (at[~whole, None] * many + inner).reshape(-1, 2)])
        kept = np.append(np.full(len(inner), seen.any()), np.repeat(seen[~whole], len(inner)))
        apart = _apart_m(split, side, count)
        kept &= (apart >= far_m) & (lattice.relative_height(split, 1) > 0)
        kept[np.flatnonzero(kept)[np.argsort(apart[kept], kind="stable")[MOST_BLOCKS_BEYOND:]]] = False
        (own, own_turn), chosen = lattice.drawn(split), whole & seen & (relative_height > 0)
        split = split[kept]
        plane_of_split, _ = lattice.planes(split, 1)
        transform = sheared(middle[chosen], plane[chosen], turn[chosen], relative_height[chosen])
        return cls(lattice, many, split, own[kept], own_turn[kept], plane_of_split, transform, variant[chosen])

    @property
    def any(self) -> bool:
        return len(self.at) + len(self.transform) > 0

    def squares(self, blocks: Blocks) -> list[FarBlock]:
        """A mesh of each variant of a square, and where it stands."""
        found = []
        inner = _grid(*(np.arange(one) for one in self.many))
        middle = (inner + 0.5 - 0.5 * self.many) * self.lattice.side_m
        for variant in range(SQUARE_VARIANTS if len(self.variant) else 0):
            own, turn = self.lattice.drawn(inner)
            rows, xy, turned = [], [], []
            for index, at, quarter in zip(own.tolist(), middle, turn, strict=True):
                plants, from_middle = blocks.of(index)
                rows.append(plants)
                xy.append(at + from_middle @ turns(np.array([quarter]))[0].T)
                turned.append(np.full(len(plants), quarter))
            if sum(map(len, rows)) and (self.variant == variant).any():
                places = self.transform[self.variant == variant]
                every = np.concatenate(rows), np.concatenate(xy), np.concatenate(turned)
                found.append(FarBlock(*every, places, wide=True))
        return found


def copied_blocks(side: Floats, count: Rows, far_m: float) -> tuple[Rows, Floats]:
    """(B, 2) columns and rows of the blocks outside, those of the site counted from 0; (B,) metres from the site."""
    more = np.ceil(far_m / side).astype(np.intp)
    columns, rows = (np.arange(-n, c + n) for n, c in zip(more, count, strict=True))
    at = _grid(columns, rows)
    at = at[((at < 0) | (at >= count)).any(axis=1)]
    apart = _apart_m(at, side, count)
    near = apart < far_m
    return at[near], apart[near]


def _grid(columns: Rows, rows: Rows) -> Rows:
    """(B, 2) all pairs."""
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


def _apart_m(at: Rows, side: Floats, count: Rows) -> Floats:
    """(B,) metres from blocks to the site; 0 of its own."""
    return np.asarray(np.hypot(*(np.maximum(np.maximum(-at - 1, at - count), 0) * side).T))


def turns(turn: Rows) -> Floats:
    """(M, 2, 2) rotations by right angles, counter-clockwise."""
    cos, sin = np.array([1.0, 0.0, -1.0, 0.0])[turn], np.array([0.0, 1.0, 0.0, -1.0])[turn]
    return np.stack([cos, -sin, sin, cos], axis=-1).reshape(-1, 2, 2)


def sheared(middle_m: Floats, plane: Floats, turn: Rows, relative_height: Floats | float = 1.0) -> Floats:
    """(M, 3, 4) from the frames of far meshes to the world: turned, stems stay upright, feet follow the plane; so much
    taller."""
    transform = np.tile(np.eye(3, 4), (len(plane), 1, 1))
    transform[:, :2, :2] = turns(turn)
    transform[:, 2, :2], transform[:, 2, 3] = (plane[:, None, :2] @ transform[:, :2, :2])[:, 0], plane[:, 2]
    transform[:, :2, 3], transform[:, 2, 2] = middle_m, relative_height
    return transform
