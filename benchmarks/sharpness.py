"""Power spectra of denoised images over those of a nearly noise-free one: `uv run python benchmarks/sharpness.py`.

Near views of leaves, 240 x 180, of 16 and 64 samples, against 1024 (`--reference`). Values are those of a picture: the
luminance over its mean, to the power 1 / 2.4. By octaves of the frequency, up to the finest that pixels hold:

- power: that of the denoised image over that of the reference; below 1 it is too smooth, above 1 noisy
- gain: the part that is in phase with the reference, which noise does not raise
- rms: of the difference, over the whole picture; the raw image's beside it
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

import forestgen as fg
from forestgen.core.spectrum import LUMINANCE

EDGES = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2)  # cycles a pixel
SKIES: dict[str, dict[str, Any]] = {
    "clear": {"sun": {"elevation_deg": 40, "azimuth_deg": 200}, "turbidity": 3},
    "overcast": {"kind": "overcast", "sun": {"elevation_deg": 40, "azimuth_deg": 200}},
}
Floats = NDArray[np.float64]


def recipe(species: str, sky: str, samples: int, seed: int) -> dict[str, Any]:
    table = [
        "species, x_m, y_m, dbh_cm, height_m, crown_width_m, crown_base_m",
        f"{species}, 10, 10, 9, 6, 3.1, 0.4",
        "birch, 12.5, 13, 9, 7, 3, 0.6",
    ]
    place = {"position_m": [9.6, 6.7, 1.8], "look_at_m": [10, 10, 2.2], "hfov_deg": 35}
    return {
        "forestgen": 1,
        "seed": seed,
        "site": {"size_m": [20, 20], "ground": {"kind": "litter"}},
        "species": {species: None, "birch": None},
        "community": {"model": "inventory", "table": "\n".join(table)},
        "sky": SKIES[sky],
        "cameras": [{"name": f"near{samples}", "size_px": [240, 180], **place}],
        "render": {"samples": samples},
        "labels": {"samples": 4},
    }


def lights(species: str, sky: str, samples: int) -> tuple[Floats, Floats]:
    """Raw and denoised (H, W, 3)."""
    (frame,) = fg.load(recipe(species, sky, samples, 1)).frames(1)
    return frame.radiance.astype(np.float64), frame.denoised.astype(np.float64)


def shown(light: Floats, reference: Floats) -> Floats:
    weights = np.array(LUMINANCE)
    return np.asarray(np.maximum(light @ weights / (reference @ weights).mean(), 0.0) ** (1 / 2.4))


def octaves(one: Floats, other: Floats) -> Floats:
    """Cross power by octave."""
    height, width = one.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    first, second = (np.fft.fft2((image - image.mean()) * window) for image in (one, other))
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(width), np.fft.fftfreq(height)))
    power = (first * second.conj()).real
    return np.array([power[(frequency >= low) & (frequency < high)].sum() for low, high in pairwise(EDGES)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reference", type=int, default=1024)
    parser.add_argument("--sky", choices=SKIES, nargs="*", default=list(SKIES))
    asked = parser.parse_args()
    for species in ("beech", "spruce"):
        for sky in asked.sky:
            reference = lights(species, sky, asked.reference)[0]
            best = shown(reference, reference)
            whole = octaves(best, best)
            for samples in (16, 64):
                raw, clean = (shown(one, reference) for one in lights(species, sky, samples))
                power, gain = octaves(clean, clean) / whole, octaves(clean, best) / whole
                rms = [float(np.sqrt(np.mean((one - best) ** 2))) for one in (raw, clean)]
                values = "  ".join(f"{p:.3f} {g:.3f}" for p, g in zip(power, gain, strict=True))
                print(f"{species:7} {sky:9} {samples:3}  {values}  rms {rms[1]:.4f} (raw {rms[0]:.4f})", flush=True)


if __name__ == "__main__":
    main()
