"""Views of three recipes beside the airborne tiles that they imitate: light, colours, gradients, local contrast.

    uv run python benchmarks/airborne_tiles.py --tiles FOLDER [--quick] [--picture FILE]
    uv run python benchmarks/airborne_tiles.py --cameras

Real windows are squares of 20 m, 10 m apart, of the tile; their spread is the 5th to the 95th percentile. Ours are
those of three stands of the recipe (`--quick`: two with half the samples); their median is inside the spread or not.
A distance of histograms is that of a window to all real ones together; its yardstick is the 95th percentile of the
real windows' distances to the others. `labels` are crowns and ground as our labels have them, which checks the two
methods that tiles allow: by boxes, and by a split of colours (tests/support/airborne.py). Light is linear, of sRGB:
what a picture shows. So ours are developed as photographs, with their recipe's blur, contrast and saturation, which
are estimates of what the camera, its raw converter and the rectification did to each tile.

`--cameras` shows how much of a colour is the camera's: leaves and ground under D65 as an eye and as the two measured
cameras see them, each with the colour matrix of least error. The camera of the tiles is not published.

The tiles are not part of the repository; without them the command says how to get them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
from PIL import Image

from forestgen.core.spectrum import LUMINANCE, Spectrum
from forestgen.dataset.colour_matrix import colour_matrix
from forestgen.dataset.photo import saturated
from forestgen.dataset.raw import d65
from forestgen.recipe.spectra import load_bands, load_spectra
from forestgen.scene.colour import colour_of_reflectance
from support.airborne import (
    HISTOGRAMS,
    Floats,
    Picture,
    chromaticity,
    compare,
    distances,
    encoded,
    figures,
    spread,
    textures,
)
from support.airborne_views import HOW_TO_GET, PLACES, Place, as_bright, jpeg_of, picture_of, tile_of, views

RECIPES = Path(__file__).parents[1] / "recipes" / "places"
STANDS, SAMPLES = 3, 64
_GAP_PX = 8
_SURFACES = ("leaves/pine", "leaves/larch", "leaves/oak", "leaves/cotton_grass", "ground/sand", "ground/litter_grass")
_SATURATION = 0.6


@dataclass(frozen=True)
class Ours:
    """Views of a recipe."""

    pictures: Sequence[Picture]
    by_labels: Sequence[dict[str, float]]  # of each picture: figures of crowns and ground by its labels


def rendered(place: Place, tile: Picture, outputs: Path, stands: int, samples: int) -> Ours:
    pictures, by_labels = [], []
    for frame in views(place, outputs, stands, RECIPES, {"render.samples": samples}):
        folder = outputs / place.recipe / frame.split / frame.name
        picture, (crowns, ground) = picture_of(frame, folder, place.greener)
        picture = as_bright(picture, tile, jpeg_of(folder))
        pictures.append(picture)
        by_labels.append(_labelled(picture.rgb[crowns], picture.rgb[ground]))
    return Ours(pictures, by_labels)


def _labelled(crowns: Floats, ground: Floats) -> dict[str, float]:
    found = {"crown / ground": float(crowns.mean(axis=0) @ LUMINANCE / (ground.mean(axis=0) @ LUMINANCE))}
    for name, light in (("crown", crowns), ("ground", ground)):
        found |= dict(zip((f"{name} u'", f"{name} v'"), chromaticity(light).tolist(), strict=True))
    return found


def print_figures(tile: Picture, ours: Ours) -> None:
    real, mine = figures(tile), [window for one in ours.pictures for window in figures(one)]
    labels = {name: np.mean([one[name] for one in ours.by_labels]) for name in ours.by_labels[0]}
    print(f"  {'':<24} {'real: 5%':>9} {'median':>8} {'95%':>8} {'ours':>8} {'labels':>8}")
    for name, (low, high, middle, found) in compare(real, mine).items():
        if np.isnan(middle):
            continue
        label = labels.get(name.partition(",")[0], np.nan)
        by_label = "" if np.isnan(label) else f"{label:.3f}"
        print(
            f"  {name:<24} {low:9.3f} {middle:8.3f} {high:8.3f} {found:8.3f} {by_label:>8}  {_held(low, found, high)}"
        )


def print_stands(ours: Ours) -> None:
    """How often a stand of ours is inside the spread of another, by the same rule."""
    held = []
    for one, other in permutations([figures(picture) for picture in ours.pictures], 2):
        found = compare(one, other)
        held.append({name: low <= value <= high for name, (low, high, _, value) in found.items()})
    inside = sum(sum(one.values()) for one in held)
    out = sorted(name for name in held[0] if not any(one[name] for one in held))
    print(
        f"  our stands beside each other: {inside} of {sum(map(len, held))} inside; never: {', '.join(out) or 'none'}"
    )


def print_histograms(tile: Picture, ours: Ours) -> None:
    real, mine = textures(tile), [textures(one) for one in ours.pictures]
    for name in HISTOGRAMS:
        windows = [window for one in mine for window in one[name]]
        to_real, between = distances(windows, real[name])
        found, (_, high) = float(np.median(to_real)), spread(between)
        print(f"  distance of {name:<12} {'':9} {np.median(between):8.3f} {high:8.3f} {found:8.3f} {'':>8}", end=" ")
        middle, ours_middle = (np.median(np.concatenate(some)) for some in (real[name], windows))
        print(f"{_held(0.0, found, high)}; medians: real {middle:.3f}, ours {ours_middle:.3f}")


def _held(low: float, value: float, high: float) -> str:
    return "inside" if low <= value <= high else "OUTSIDE"


def print_cameras() -> None:
    """u'v' of leaves and ground by camera, at about the saturation of the recipes' photographs (0.5 to 0.65)."""
    light = d65()
    cameras = {name: load_bands(name) for name in ("nikon_5100", "sigma_sdmerill")}
    matrices = {name: colour_matrix(bands, light) for name, bands in cameras.items()}
    print(f"{'u, v of a photograph':<24}" + "".join(f"{name:>18}" for name in ("eye", *cameras)) + "   apart")
    for surface in _SURFACES:
        columns = load_spectra(surface)
        spectrum = next(columns[name] for name in ("reflectance_summer", "reflectance") if name in columns)
        seen = [colour_of_reflectance(spectrum)]
        product = Spectrum(light.wavelength_nm, spectrum.at(light.wavelength_nm) * light.value)
        for name, bands in cameras.items():
            balanced = np.array([band.mean(product) / band.mean(light) for band in bands])
            seen.append(matrices[name] @ balanced)
        found = np.array([chromaticity(saturated(one[None, None], _SATURATION)[0]) for one in seen])
        apart = np.hypot(*(found[:, None] - found[None]).T).max()
        print(f"{surface:<24}" + "".join(f"{u:>11.3f} {v:.3f} " for u, v in found) + f"{apart:>8.3f}")


def side_by_side(rows: Sequence[Sequence[Picture]]) -> Image.Image:
    """A row a place: squares of the tile and of our views."""
    side = min(min(one.rgb.shape[:2]) for row in rows for one in row)
    width, height = max(len(row) for row in rows), len(rows)
    sheet = Image.new("RGB", (width * (side + _GAP_PX) - _GAP_PX, height * (side + _GAP_PX) - _GAP_PX), "white")
    for y, row in enumerate(rows):
        for x, one in enumerate(row):
            at = x * (side + _GAP_PX), y * (side + _GAP_PX)
            top = max(0, (one.rgb.shape[0] - side) * 3 // 4)
            left = max(0, (one.rgb.shape[1] - side) * 3 // 4)
            sheet.paste(Image.fromarray(encoded(one.rgb[top : top + side, left : left + side])), at)
    return sheet


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiles", type=Path, help="folder of the tiles")
    parser.add_argument("--quick", action="store_true", help="two stands a recipe, with half the samples")
    parser.add_argument("--place", choices=[place.recipe for place in PLACES], help="one recipe; by default all")
    parser.add_argument("--out", type=Path, default=Path("outputs/airborne"), help="folder of the views")
    parser.add_argument("--picture", type=Path, help="where to write real tiles beside ours")
    parser.add_argument("--cameras", action="store_true", help="show how colours differ by camera instead")
    arguments = parser.parse_args()
    if arguments.cameras:
        print_cameras()
        return
    if arguments.tiles is None:
        raise SystemExit(HOW_TO_GET)
    stands, samples = (2, SAMPLES // 2) if arguments.quick else (STANDS, SAMPLES)
    rows = []
    for place in PLACES:
        if arguments.place not in (None, place.recipe):
            continue
        tile = tile_of(place, arguments.tiles)
        ours = rendered(place, tile, arguments.out / ("quick" if arguments.quick else "full"), stands, samples)
        print(f"{place.tile} and recipes/places/{place.recipe}.yaml, {stands} stands", flush=True)
        print_figures(tile, ours)
        print_histograms(tile, ours)
        print_stands(ours)
        rows.append([tile, *ours.pictures[:2]])
    if arguments.picture:
        side_by_side(rows).save(arguments.picture)


if __name__ == "__main__":
    main()
