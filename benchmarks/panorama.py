"""The recipe conifer_hdri beside the measured panorama of a pine forest that it reconstructs.

    curl -O https://registry.npmjs.org/@pmndrs/assets/-/assets-1.7.0.tgz && tar xzf assets-1.7.0.tgz package/hdri
    PYTHONPATH=tests uv run python benchmarks/panorama.py --panorama package/hdri/forest.exr.js [--picture both.png]
    PYTHONPATH=tests uv run python benchmarks/panorama.py --places 9

The panorama is one of Poly Haven (CC0), 512 x 256 pixels. Ours is rendered twice as large each way and made smaller by
Lanczos' filter, as the values below zero of the measured one show that it was. Its balance of colours is not known:
ours is balanced by sunlight, as on a chart in the sun, which makes the skies alike. One factor gives both the same mean
log luminance over the sphere. The figures are those of tests/support/panoramas.py; about five minutes. Exit 1 where a
bound is broken.

`--places` compares places of our own stand with each other by the same figures, at 512 x 256 pixels and 16 samples: how
many of the bounds one stand keeps against itself, a few metres away.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from itertools import permutations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.dataset.tonemap import tone_map
from forestgen.pipeline import assemble_image, image_frames
from forestgen.recipe.load import load_recipe
from forestgen.render.light import sun_irradiance
from forestgen.scene.colour import RGB
from forestgen.scene.plan import check_plan
from support.panoramas import BANDS_DEG, GAPS_ABOVE_DEG, Floats, compare, exact_gaps, halved, mean_log, read_panorama

FETCH = "curl -O https://registry.npmjs.org/@pmndrs/assets/-/assets-1.7.0.tgz && tar xzf assets-1.7.0.tgz package/hdri"
RECIPE = Path(__file__).parents[1] / "recipes" / "places" / "conifer_hdri.yaml"
_MIDDLE_M = (10.0, 50.0)  # of the plot's 60 m
_PLASTIC = 1.32471795724  # x³ = x + 1: Roberts, M. 2018, The unreasonable effectiveness of quasirandom sequences


def rendered(overrides: list[str]) -> Iterator[tuple[Floats, NDArray[np.bool_]]]:
    """Panoramas of the recipe's cameras, balanced, and where each has sky."""
    scene = assemble_image(check_plan(load_recipe(RECIPE, overrides)), Silent(), Timings())
    white = sun_irradiance(scene.spec.sky, RGB)
    for image in image_frames(scene, Silent(), Timings()):
        frame = image.labelled.frame
        light = frame.radiance.mean if frame.radiance.denoised is None else frame.radiance.denoised
        yield light * (white[1] / white), frame.surface.part == Part.NOTHING


def compare_places(count: int) -> None:
    """Print how often places of our stand keep the bounds against each other."""
    same = "kind: panorama, size_px: [512, 256], obstructed: note"
    cameras = [f"{{name: p{k}, position_m: [{x:.1f}, {y:.1f}, 1.5], {same}}}" for k, (x, y) in enumerate(places(count))]
    pictures = [one for one, _ in rendered([f"cameras=[{', '.join(cameras)}]", "render.samples=16"])]
    differences, kept = defaultdict(list), []
    for one, other in permutations(pictures, 2):
        figures = compare(one, other * np.exp(mean_log(one) - mean_log(other)))
        kept.append(sum(figure.kept for figure in figures))
        for figure in figures:
            differences[figure.band, figure.name, figure.bound].append(figure.difference)
    print(f"{'elevation':<12}{'figure':<17}{'bound':>7}{'median':>9}{'95%':>8}{'kept':>7}")
    for (band, name, bound), values in differences.items():
        share = np.mean(np.array(values) <= bound)
        print(f"{band:<12}{name:<17}{bound:>7}{np.median(values):>9.3f}{np.percentile(values, 95):>8.3f}{share:>7.0%}")
    low, middle, high = np.percentile(kept, [5, 50, 95])
    print(f"{count} places, {len(kept)} pairs: {middle:.0f} of {len(differences)} kept ({low:.0f} to {high:.0f})")


def places(count: int) -> Floats:
    """(N, 2) positions in the middle of the plot, spread evenly: the sequence R2 of the plastic number."""
    steps = np.array([1.0 / _PLASTIC, 1.0 / _PLASTIC**2])
    return _MIDDLE_M[0] + (_MIDDLE_M[1] - _MIDDLE_M[0]) * ((0.5 + np.outer(np.arange(count), steps)) % 1.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--panorama", type=Path, help="forest.exr.js of the package, or an .exr")
    parser.add_argument("--samples", type=int, help="light paths a pixel; by default those of the recipe")
    parser.add_argument("--picture", type=Path, help="PNG: the measured panorama above ours")
    parser.add_argument("--places", type=int, help="compare this number of places of our stand with each other instead")
    arguments = parser.parse_args()
    if arguments.places is not None:
        if arguments.places < 2:
            parser.error(f"--places: expected at least 2 places to compare, got {arguments.places}")
        compare_places(arguments.places)
        return 0
    if arguments.panorama is None or not arguments.panorama.is_file():
        parser.error(f"--panorama: there is no {arguments.panorama or 'file'}. To fetch forest.exr.js:\n{FETCH}")
    real = read_panorama(arguments.panorama)
    ours, sky = next(rendered([] if arguments.samples is None else [f"render.samples={arguments.samples}"]))
    ours = halved(ours)
    ours *= np.exp(mean_log(real) - mean_log(ours))
    print(f"{'elevation':<12}{'figure':<17}{'measured':>12}{'ours':>13}{'differs':>10}{'bound':>7}")
    figures = compare(real, ours)
    for one in figures:
        held = "kept" if one.kept else "MISSED"
        values = f"{one.real:>12}{one.ours:>13}{one.difference:>10.3f}{one.bound:>7}"
        print(f"{one.band:<12}{one.name:<17}{values}   {held}")
    print(f"{sum(one.kept for one in figures)} of {len(figures)} kept")
    gaps = (
        f"{low} to {high}: {gap:.3f}"
        for (low, high), gap in zip(BANDS_DEG, exact_gaps(sky), strict=True)
        if low >= GAPS_ABOVE_DEG
    )
    print("exact gap fraction of ours: " + ", ".join(gaps))
    if arguments.picture:
        exposure = 0.18 / float(np.exp(mean_log(real)))
        both = [tone_map(one.astype(np.float32), exposure) for one in (real, ours)]
        Image.fromarray(np.concatenate(both)).save(arguments.picture)
    return int(not all(one.kept for one in figures))


if __name__ == "__main__":
    sys.exit(main())
