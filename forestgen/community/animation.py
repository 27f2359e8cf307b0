"""A community's circles in time as a small animated picture (Lane 2002, Figures 4.3, 4.5 and 4.6)."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from forestgen.community.model import Site
from forestgen.community.plan import NO_OBSTACLES, Obstacles
from forestgen.community.plots import OBSTACLE, colours_of
from forestgen.community.population import Population, Status
from forestgen.core.errors import writing

MOST_FRAMES = 60
MOST_BYTES = 3_000_000
_LONGEST_PX = 440  # of the site's longer side
_CAPTION_PX = 24
_FINER = 2  # drawn so many times larger, then averaged: smooth edges
_GROUND = (250, 248, 243)
_INK = (60, 60, 60)
_FRAME_MS, _LAST_MS = 110, 2500
_MOST_COLOURS = 256
_LEAST_PX = 200  # wide: room for the caption
_SMALL_PX, _LEAST_RADIUS_PX = 5.0, 1.0  # before the averaging: circles without an edge; and the smallest
_OPACITY, _DARKER = 0.55, 0.7  # of fills, and of edges, as on the map


class Film:
    """Frames of an animation, drawn as snapshots come; it keeps the frames, a byte a pixel, and no snapshot.

    `periodic` circles that reach over an edge continue at the opposite one. Obstacles are drawn as their ground plans,
    below the circles; the snapshots must not hold them as plants.
    """

    def __init__(
        self,
        site: Site,
        species_names: Sequence[str],
        species_colours: Mapping[str, str],
        *,
        periodic: bool,
        obstacles: Obstacles = NO_OBSTACLES,
    ) -> None:
        self._site, self._periodic, self._obstacles = site, periodic, obstacles
        colours = colours_of(species_colours, species_names)
        self._rgb = [_rgb(colours[name]) for name in species_names]
        scale = _LONGEST_PX / max(site.size_m)
        self._size_px = max(1, round(site.size_m[0] * scale)), max(1, round(site.size_m[1] * scale))
        self._palette = _palette([*self._rgb, _rgb(OBSTACLE)] if obstacles.entries else self._rgb)
        self._frames: list[Image.Image] = []

    def add(self, population: Population) -> None:
        """Draw a frame."""
        width, height = self._size_px
        frame = Image.new("RGB", (max(width, _LEAST_PX), height + _CAPTION_PX), "white")
        frame.paste(self._ground(population).reduce(_FINER), (0, _CAPTION_PX))
        n = int(np.count_nonzero(population.status != Status.DEAD))
        text = f"{population.time_yr:g} years   {n:,} plants"
        ImageDraw.Draw(frame).text((6, 4), text, fill=_INK, font=ImageFont.load_default(13))
        self._frames.append(frame.quantize(palette=self._palette, dither=Image.Dither.NONE))

    def _ground(self, population: Population) -> Image.Image:
        """Circles, small ones above large ones as on the map."""
        width, height = (side * _FINER for side in self._size_px)
        scale = width / self._site.size_m[0]
        alive = np.flatnonzero(population.status != Status.DEAD)
        order = alive[np.argsort(-population.radius_m[alive], kind="stable")]
        centre = population.position_m[order, :2] * (scale, -scale) + (0, height)
        radius, kind = population.radius_m[order] * scale, population.species[order]
        ground = Image.new("RGB", (width, height), _GROUND)
        for one in self._obstacles.entries:
            corners = one.corners_m() * (scale, -scale) + (0, height)
            ImageDraw.Draw(ground).polygon([(x, y) for x, y in corners.tolist()], fill=_rgb(OBSTACLE))
        draw = ImageDraw.Draw(ground)
        fills = [_mixed(rgb, _GROUND, _OPACITY) for rgb in self._rgb]
        edges = [_mixed(rgb, (0, 0, 0), _DARKER) for rgb in self._rgb]
        for (x, y), r, k in zip(centre.tolist(), radius.tolist(), kind.tolist(), strict=True):
            fill, outline = (fills[k], edges[k]) if r >= _SMALL_PX else (self._rgb[k], None)
            r = max(r, _LEAST_RADIUS_PX)
            for dx in self._shifts(x, r, width):
                for dy in self._shifts(y, r, height):
                    draw.ellipse((x + dx - r, y + dy - r, x + dx + r, y + dy + r), fill, outline, _FINER)
        return ground

    def _shifts(self, at: float, radius: float, size: float) -> tuple[float, ...]:
        """How far to move a circle so that all of it is seen."""
        if self._periodic and at < radius:
            return (0.0, size)
        if self._periodic and at + radius > size:
            return (0.0, -size)
        return (0.0,)

    def write(self, path: Path) -> None:
        """Write the frames as a GIF of at most `MOST_BYTES`, with fewer frames where that takes it."""
        if not self._frames:
            raise ValueError("an animation needs at least one frame")
        frames = self._frames
        data = _gif(frames)
        while len(data) > MOST_BYTES and len(frames) > 2:
            stride = math.ceil(len(data) / MOST_BYTES) if len(frames) > 4 else 2
            frames = [*frames[:-1][:: max(2, stride)], frames[-1]]
            data = _gif(frames)
        with writing(path, "the animation cannot be written"):
            path.write_bytes(data)


def _gif(frames: Sequence[Image.Image]) -> bytes:
    stream = io.BytesIO()
    duration = [_FRAME_MS] * (len(frames) - 1) + [_LAST_MS]
    frames[0].save(
        stream, format="GIF", save_all=True, append_images=frames[1:], duration=duration, loop=0, optimize=False
    )
    return stream.getvalue()


def _rgb(colour: str) -> tuple[int, int, int]:
    red, green, blue = ImageColor.getrgb(colour)[:3]
    return red, green, blue


def _mixed(one: tuple[int, int, int], other: tuple[int, int, int], share: float) -> tuple[int, int, int]:
    red, green, blue = (round(share * a + (1 - share) * b) for a, b in zip(one, other, strict=True))
    return red, green, blue


def _palette(species: Sequence[tuple[int, int, int]]) -> Image.Image:
    """The colours of all frames: ground, caption, and each species with the steps between its edge, fill and ground."""
    colours = [_GROUND, (255, 255, 255), *(_mixed(_INK, (255, 255, 255), share) for share in (0.25, 0.5, 0.75, 1.0))]
    for rgb in species:
        fill, edge = _mixed(rgb, _GROUND, _OPACITY), _mixed(rgb, (0, 0, 0), _DARKER)
        for one, other in ((fill, _GROUND), (edge, fill), (edge, _GROUND), (rgb, _GROUND)):
            colours += [_mixed(one, other, share) for share in (1.0, 0.66, 0.33)]
    distinct = list(dict.fromkeys(colours))[:_MOST_COLOURS]
    flat: NDArray[np.uint8] = np.array(distinct + [distinct[0]] * (256 - len(distinct)), dtype=np.uint8)
    image = Image.new("P", (1, 1))
    image.putpalette(flat.tobytes())
    return image
