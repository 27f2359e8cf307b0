"""The recipe conifer_hdri beside the measured panorama of a pine forest that it reconstructs.

    curl -O https://registry.npmjs.org/@pmndrs/assets/-/assets-1.7.0.tgz && tar xzf assets-1.7.0.tgz package/hdri
    PYTHONPATH=tests uv run python benchmarks/panorama.py --panorama package/hdri/forest.exr.js [--picture both.png]

The panorama is one of Poly Haven (CC0), 512 x 256 pixels. Ours is rendered twice as large each way and made smaller by
Lanczos' filter, as the values below zero of the measured one show that it was. Its balance of colours is not known:
ours is balanced by sunlight, as on a chart in the sun, which makes the skies alike. One factor gives both the same mean
log luminance over the sphere. The figures are those of tests/support/panoramas.py; about five minutes. Exit 1 where a
bound is broken.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
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


def rendered(samples: int | None) -> tuple[Floats, list[float]]:
    """Our panorama, balanced, and its exact gap fraction by band."""
    overrides = [] if samples is None else [f"render.samples={samples}"]
    scene = assemble_image(check_plan(load_recipe(RECIPE, overrides)), Silent(), Timings())
    frame = next(iter(image_frames(scene, Silent(), Timings()))).labelled.frame
    white = sun_irradiance(scene.spec.sky, RGB)
    light = frame.radiance.mean if frame.radiance.denoised is None else frame.radiance.denoised
    return halved(light * (white[1] / white)), exact_gaps(frame.surface.part == Part.NOTHING)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--panorama", type=Path, required=True, help="forest.exr.js of the package, or an .exr")
    parser.add_argument("--samples", type=int, help="light paths a pixel; by default those of the recipe")
    parser.add_argument("--picture", type=Path, help="PNG: the measured panorama above ours")
    arguments = parser.parse_args()
    if not arguments.panorama.is_file():
        parser.error(f"--panorama: there is no {arguments.panorama}. To fetch forest.exr.js:\n{FETCH}")
    real = read_panorama(arguments.panorama)
    ours, exact = rendered(arguments.samples)
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
        for (low, high), gap in zip(BANDS_DEG, exact, strict=True)
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
