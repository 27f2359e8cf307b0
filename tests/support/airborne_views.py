"""The development tiles of the NEON airborne camera, and views of the recipes that imitate them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image, ImageDraw

import forestgen as fg
from forestgen.core.spectrum import LUMINANCE
from forestgen.dataset.photo import saturated, sharpened
from forestgen.dataset.tonemap import filmic
from forestgen.recipe.exposure import Jpeg
from support.airborne import Box, Floats, Mask, Picture, boxes_of, crowns_and_ground, encoded, linear, sunlit

HOW_TO_GET = """The tiles travel in the wheel of deepforest 2.1.0 on PyPI; they are not part of this repository.

    pip download deepforest==2.1.0 --no-deps
    unzip -j deepforest-2.1.0-py3-none-any.whl 'deepforest/data/*OSBS_029*' 'deepforest/data/SOAP_031*' \\
        'deepforest/data/2019_YELL_2_541000*' -d FOLDER"""

TREE_M, TREE_PX = 2.0, 10  # what a person draws a box around: trees of this height, seen this widely
_WHITE = 1.91  # saturation, where middle grey is 0.18: of raw converters, forestgen/dataset/tonemap.py
_EXPOSURES = 8
_DEAD_LYING = 2  # dead_form from which a dead tree does not stand
# Outline of the road in Yellowstone, pixels: x of the western and of the eastern side, and y of each.
_ROAD = (
    ((135, 148, 171, 202, 249, 316, 394, 482, 571, 617), (0, 88, 187, 280, 394, 519, 633, 768, 892, 1035)),
    ((212, 239, 254, 290, 358, 420, 503, 571, 628, 711), (0, 135, 207, 311, 436, 550, 705, 861, 934, 1035)),
)


@dataclass(frozen=True)
class Place:
    """A tile and its recipe."""

    tile: str
    recipe: str
    greener: bool  # whether crowns are greener than what is between them
    has_road: bool = False


PLACES = (
    Place("OSBS_029", "neon_osbs", greener=True),
    Place("SOAP_031", "neon_soap", greener=True),
    Place("2019_YELL_2_541000_4977000_image_crop", "neon_yell", greener=False, has_road=True),
)


def tile_of(place: Place, folder: Path) -> Picture:
    """A real tile."""
    path = folder / f"{place.tile}.png"
    if not path.is_file():
        raise SystemExit(f"{path} is missing.\n{HOW_TO_GET}")
    rgb = linear(np.asarray(Image.open(path).convert("RGB")))
    shape = (rgb.shape[0], rgb.shape[1])
    boxes = folder / f"{place.tile}.xml"
    crowns, ground = crowns_and_ground(boxes_of(boxes), shape) if boxes.is_file() else (None, None)
    return Picture(rgb, crowns, ground, _off_road(shape) if place.has_road else None, place.greener)


def _off_road(shape: tuple[int, int]) -> Mask:
    west, east = (list(zip(*side, strict=True)) for side in _ROAD)
    picture = Image.new("1", shape[::-1])
    ImageDraw.Draw(picture).polygon([*west, *east[::-1]], fill=1)
    return ~np.asarray(picture)


def views(place: Place, folder: Path, count: int, recipes: Path, settings: dict[str, object]) -> Iterator[fg.Frame]:
    """Frames of the place's recipe, each of its own stand; those that `folder` has are not rendered again."""
    recipe = fg.load(recipes / f"{place.recipe}.yaml", settings)
    yield from recipe.render(folder / place.recipe, count=count, resume=True, discard=True).dataset


def picture_of(frame: fg.Frame, folder: Path, greener: bool) -> tuple[Picture, tuple[Mask, Mask]]:
    """A frame as the airborne camera has it, with boxes of its trees; and by its labels sunlit crowns and ground."""
    rgb = developed(folder)
    shape = (rgb.shape[0], rgb.shape[1])
    crowns, ground = crowns_and_ground(tree_boxes(frame), shape)
    picture = Picture(rgb, crowns, ground, None, greener)
    lit = sunlit(picture)
    plants = frame.plants.to_pandas()
    trees = plants.plant_id[(plants.height_m >= TREE_M) & (plants.status != "dead")]
    is_tree = np.isin(frame.instance, trees.to_numpy())
    is_low = (frame.instance == 0) | np.isin(frame.instance, plants.plant_id[plants.height_m < TREE_M].to_numpy())
    return picture, (is_tree & lit, is_low & lit)


def tree_boxes(frame: fg.Frame) -> list[Box]:
    """Visible boxes of what stands: trees, dead ones too."""
    plants = frame.plants.to_pandas()
    stands = (plants.height_m >= TREE_M) & ~(plants.dead_form.fillna(0) >= _DEAD_LYING)
    seen = plants[stands & (np.minimum(plants.box_w, plants.box_h) >= TREE_PX)]
    return [(x, y, x + w, y + h) for x, y, w, h in zip(seen.box_x, seen.box_y, seen.box_w, seen.box_h, strict=True)]


def developed(folder: Path) -> Floats:
    """(H, W, 3) linear Rec. 709 of a frame's raw image, white where a white surface in the open is; with the
    saturation of its photograph."""
    facts = json.loads((folder / "raw.json").read_text(encoding="utf-8"))
    white = open_irradiance(folder)
    planes = []
    for name in facts["channels"]:
        counts = np.asarray(Image.open(folder / facts["files"][name])).astype(np.float64)
        light = np.maximum(counts - facts["black_level"], 0.0) * facts["radiance_per_dn"][name]
        planes.append(np.pi * light / white[name])
    rgb = np.stack(planes, axis=-1) @ np.array(facts["colour_matrix"]).T
    return saturated(rgb, facts["photo"]["saturation"])


def jpeg_of(folder: Path) -> Jpeg:
    """How a frame's photograph was made."""
    facts = json.loads((folder / "raw.json").read_text(encoding="utf-8"))["photo"]
    return Jpeg(**{name: facts[name] for name in Jpeg.model_fields if name in facts})


def open_irradiance(folder: Path) -> dict[str, float]:
    """Of level ground in the open, by channel, W/m2/nm."""
    with OpenEXR.File(str(folder / "frame.exr"), header_only=True) as file:
        return dict(json.loads(file.parts[0].header["forestgen/open_irradiance"]))


def as_bright(picture: Picture, like: Picture, jpeg: Jpeg) -> Picture:
    """The picture as a camera's raw converter makes it, exposed so that its sunlit pixels have the other's median."""
    wanted = np.median((like.rgb @ LUMINANCE)[sunlit(like)])
    exposure = wanted / np.median((picture.rgb @ LUMINANCE)[sunlit(picture)])
    for _ in range(_EXPOSURES):
        shown = filmic((picture.rgb * exposure).astype(np.float32), _WHITE, jpeg.contrast)
        exposed = replace(picture, rgb=linear(sharpened(shown, jpeg.sharpening)))
        exposure *= wanted / np.median((exposed.rgb @ LUMINANCE)[sunlit(exposed)])
    return exposed


def as_coloured(picture: Picture, like: Picture) -> Picture:
    """The picture with the other's mean and covariance of sRGB values.

    The linear map that moves normal distributions least: Pitié and Kokaram 2007, 4th European Conference on Visual
    Media Production.
    """
    own, other = (encoded(one.rgb[one.counts][None])[0] / 255.0 for one in (picture, like))
    root = _root(np.cov(own.T) + 1e-9 * np.eye(3))
    inverse = np.linalg.inv(root)
    turn = inverse @ _root(root @ np.cov(other.T) @ root) @ inverse
    values = (encoded(picture.rgb) / 255.0 - own.mean(axis=0)) @ turn + other.mean(axis=0)
    return replace(picture, rgb=linear(np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)))


def _root(matrix: Floats) -> Floats:
    """Of a symmetric matrix."""
    value, vector = np.linalg.eigh(matrix)
    return np.asarray((vector * np.sqrt(np.maximum(value, 0.0))) @ vector.T)
