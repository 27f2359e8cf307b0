"""How well a small network tells patches of our views from patches of the airborne tiles that they imitate.

    uv run python benchmarks/airborne_tiles.py --tiles FOLDER
    uv run --with jax python benchmarks/patch_classifier.py --tiles FOLDER [--before DATA_SET] [--grey]

Views get the mean and the covariance of the tile's colours, each channel of a patch of 64 pixels is standardised, and
the same noise is added to real ones and ours: exposure, colours and grain tell little. Four convolutions of stride 2,
mean over the patch, 500 steps of Adam. The network learns from the western part of each tile and from half of our
stands; it is tested on the rest of the tile and on the other stands. 0.5 is chance. The views are those that the first
command renders.
`--before` takes the views of another data set, such as recipes/drone.yaml from the same height, for all three places:

    uv run forestgen render recipes/drone.yaml --count 4 -o DATA_SET --set 'cameras=[{name: airborne, position_m: \
        [30, 30, 1000], look_at_m: [30, 30, 0], size_px: [400, 400], hfov_deg: 2.2918}]'
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import forestgen as fg
from forestgen.core.spectrum import LUMINANCE
from forestgen.recipe.exposure import Jpeg
from support.airborne import Floats, Mask, Picture, encoded
from support.airborne_views import PLACES, as_bright, as_coloured, developed, jpeg_of, tile_of

PATCH_PX, BATCH, CHANNELS = 64, 64, (24, 48, 64, 64)
WEST = 0.55  # share of a tile's width that the network learns from
NOISE = 0.25  # standard deviations of a patch
RATE, DECAY_1, DECAY_2 = 1e-3, 0.9, 0.999
TESTED = 600  # patches of each kind and place
Patches = NDArray[np.float32]


def patches(pictures: Sequence[tuple[Floats, Mask]], count: int, rng: np.random.Generator) -> Patches:
    """(N, 64, 64, 3) standardised squares of sRGB pictures, at random places where all counts."""
    found: list[Floats] = []
    for _ in range(1000 * count):
        if len(found) == count:
            break
        rgb, counts = pictures[rng.integers(len(pictures))]
        top, left = (int(rng.integers(side - PATCH_PX + 1)) for side in rgb.shape[:2])
        at = (slice(top, top + PATCH_PX), slice(left, left + PATCH_PX))
        if counts[at].all():
            found.append(standardised(rgb[at]))
    if len(found) < count:
        raise SystemExit(f"too few squares of {PATCH_PX} pixels in which all counts: {len(found)} of {count}")
    return np.asarray(found, dtype=np.float32)


def standardised(patch: Floats) -> Floats:
    """The patch with a mean of 0 and a standard deviation of 1 in each channel."""
    return (patch - patch.mean(axis=(0, 1))) / np.maximum(patch.std(axis=(0, 1)), 1e-6)


def parts(pictures: Sequence[Picture], side: str) -> list[tuple[Floats, Mask]]:
    """sRGB and what counts of the western or the eastern part; of several pictures, the first or the second half."""
    if len(pictures) > 1:
        half = len(pictures) // 2
        chosen = pictures[:half] if side == "west" else pictures[half:]
        return [(encoded(one.rgb) / 255.0, one.counts) for one in chosen]
    (one,) = pictures
    edge = round(WEST * one.rgb.shape[1])
    at = slice(None, edge) if side == "west" else slice(edge, None)
    return [(encoded(one.rgb[:, at]) / 255.0, one.counts[:, at])]


def data(
    real: Sequence[Picture], ours: Sequence[Sequence[Picture]], side: str, count: int, rng: np.random.Generator
) -> tuple[Patches, NDArray[np.float32]]:
    """Patches of all places, as many real (1) as ours (0); with noise."""
    some = [patches(parts([tile], side), count, rng) for tile in real]
    some += [patches(parts(views, side), count, rng) for views in ours]
    values = np.concatenate(some)
    values += NOISE * rng.standard_normal(values.shape, dtype=np.float32)
    return values, np.repeat(np.float32([1, 0]), count * len(real))


class Network:
    """Convolutions, mean, a weighted sum; trained by Adam on the logistic loss."""

    def __init__(self, seed: int) -> None:
        import jax

        self._jax, self._np = jax, jax.numpy
        rng = np.random.default_rng(seed)
        self.weights: list[Any] = []
        before = 3
        for channels in CHANNELS:
            scale = np.sqrt(2.0 / (9 * before))
            self.weights.append(np.float32(scale * rng.standard_normal((3, 3, before, channels))))
            self.weights.append(np.zeros(channels, dtype=np.float32))
            before = channels
        self.weights += [np.float32(rng.standard_normal(before) / np.sqrt(before)), np.float32(0.0)]

    def score(self, weights: Sequence[Any], values: Any) -> Any:
        """(N,) above 0: real."""
        for kernel, bias in zip(weights[:-2:2], weights[1:-2:2], strict=True):
            layout = ("NHWC", "HWIO", "NHWC")
            values = self._jax.lax.conv_general_dilated(values, kernel, (2, 2), "SAME", dimension_numbers=layout)
            values = self._np.maximum(values + bias, 0.0)
        return values.mean(axis=(1, 2)) @ weights[-2] + weights[-1]

    def train(self, values: Patches, real: NDArray[np.float32], steps: int, rng: np.random.Generator) -> None:
        def loss(weights: Sequence[Any], some: Any, wanted: Any) -> Any:
            score = self.score(weights, some)
            return (self._np.logaddexp(0.0, score) - wanted * score).mean()

        slope = self._jax.jit(self._jax.grad(loss))
        first = [np.zeros_like(one) for one in self.weights]
        second = [np.zeros_like(one) for one in self.weights]
        for step in range(1, steps + 1):
            chosen = rng.integers(len(values), size=BATCH)
            some = values[chosen][:, :: rng.choice([-1, 1]), :: rng.choice([-1, 1])]
            slopes = [np.asarray(one) for one in slope(self.weights, some, real[chosen])]
            first = [DECAY_1 * m + (1 - DECAY_1) * g for m, g in zip(first, slopes, strict=True)]
            second = [DECAY_2 * v + (1 - DECAY_2) * g * g for v, g in zip(second, slopes, strict=True)]
            rate = RATE * np.sqrt(1 - DECAY_2**step) / (1 - DECAY_1**step)
            moved = zip(self.weights, first, second, strict=True)
            self.weights = [np.float32(w - rate * m / (np.sqrt(v) + 1e-8)) for w, m, v in moved]

    def right(self, values: Patches, real: NDArray[np.float32]) -> NDArray[np.bool_]:
        score = self._jax.jit(self.score)
        found = [np.asarray(score(self.weights, values[k : k + BATCH])) for k in range(0, len(values), BATCH)]
        return (np.concatenate(found) > 0.0) == (real > 0.5)


def views_of(data_set: Path, tile: Picture) -> list[Picture]:
    """Of a data set, as bright and coloured as a tile: of raw images if there are any, else of the radiance."""
    found = []
    for frame in fg.Dataset(data_set):
        folder = data_set / frame.split / frame.name
        light = frame.radiance if frame.denoised is None else frame.denoised
        if (folder / "raw.json").is_file():
            picture = as_bright(Picture(developed(folder)), tile, jpeg_of(folder))
        else:
            picture = as_bright(Picture(light.astype(np.float64).clip(0.0)), tile, Jpeg())
        found.append(as_coloured(picture, tile))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiles", type=Path, required=True, help="folder of the tiles")
    parser.add_argument("--views", type=Path, default=Path("outputs/airborne/full"), help="folder of the views")
    parser.add_argument("--before", type=Path, metavar="DATA_SET", help="views in place of those")
    parser.add_argument("--grey", action="store_true", help="of luminance alone")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--runs", type=int, default=3, help="networks, each with other random numbers")
    arguments = parser.parse_args()
    real = [tile_of(place, arguments.tiles) for place in PLACES]
    folders = [arguments.before or arguments.views / place.recipe for place in PLACES]
    ours = [views_of(folder, tile) for folder, tile in zip(folders, real, strict=True)]
    if arguments.grey:
        real, ours = [grey(one) for one in real], [[grey(one) for one in some] for some in ours]
    report(real, ours, arguments.steps, arguments.runs)


def grey(picture: Picture) -> Picture:
    return replace(picture, rgb=np.repeat((picture.rgb @ LUMINANCE)[..., None], 3, axis=-1))


def report(real: Sequence[Picture], ours: Sequence[Sequence[Picture]], steps: int, runs: int) -> None:
    shares = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        network = Network(seed)
        network.train(*data(real, ours, "west", 2 * TESTED, rng), steps, rng)
        right = network.right(*data(real, ours, "east", TESTED, rng))
        shares.append(right.reshape(2, len(real), TESTED).mean(axis=-1))
        print(f"  network {seed}: {right.mean():.3f} of unseen patches are classified correctly", flush=True)
    mean = np.mean(shares, axis=0)
    for k, place in enumerate(PLACES):
        print(f"  {place.recipe}: {mean[:, k].mean():.3f} (real {mean[0, k]:.3f}, ours {mean[1, k]:.3f})")
    print(f"accuracy {mean.mean():.3f} on unseen patches, {runs} networks of {steps} steps; 0.5 is chance")


if __name__ == "__main__":
    main()
