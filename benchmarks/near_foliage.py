"""Radiance and cover of trees whose leaves all have their true size, over those of the same trees as drawn from afar.

    uv run python benchmarks/near_foliage.py beech birch oak pine spruce --pixel-m 0.003

Four trees of 5 m in a square, from above, from the sun's side and from the other side. A pixel's radiance is taken as a
mixture of plants and background by its coverage; the plants' is that of the best fit.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import forestgen as fg
from forestgen.scene import near_foliage

WIDE = {"spruce": 0.34, "pine": 0.36, "birch": 0.42}  # of a crown over the height; others: 0.5
HEIGHT_M, APART = 5.0, 0.62
Floats = NDArray[np.float64]


def recipe(name: str, near: bool) -> dict[str, Any]:
    wide_m = WIDE.get(name, 0.5) * HEIGHT_M
    step_m = APART * wide_m
    rows = ["species, x_m, y_m, dbh_cm, height_m, crown_width_m, crown_base_m"]
    for i in range(2):
        for j in range(2):
            place = f"{5 + step_m * (i - 0.5):.2f}, {5 + step_m * (j - 0.5):.2f}"
            rows.append(
                f"{name}, {place}, {1.3 * HEIGHT_M:.1f}, {HEIGHT_M * (1 + 0.03 * (i - j)):.2f}, {wide_m:.2f}, 0.6"
            )
    camera = {"kind": "orthographic", "width_m": 1.1 * step_m, "size_px": [128, 128]}
    middle = [5, 5, 0.5 * HEIGHT_M]
    return {
        "forestgen": 1,
        "seed": 1,
        "site": {"size_m": [10, 10], "ground": {"kind": "litter"}},
        "species": {name: None},
        "community": {"model": "inventory", "table": "\n".join(rows)},
        "plants": {"near_foliage": near, "cache": False},
        "sky": {"sun": {"elevation_deg": 45, "azimuth_deg": 200}, "turbidity": 3},
        "cameras": [
            {"name": "above", "position_m": [5, 5, 30], "look_at_m": [5, 5, 0], **camera},
            {"name": "sunny_side", "position_m": [5, -15, 0.5 * HEIGHT_M], "look_at_m": middle, **camera},
            {"name": "other_side", "position_m": [5, 25, 0.5 * HEIGHT_M], "look_at_m": middle, **camera},
        ],
        "render": {"samples": 64, "denoise": False},
        "labels": {"samples": 16},
    }


def measured(name: str, near: bool) -> dict[str, tuple[float, float, float]]:
    """By camera: mean radiance, that of plants, and their cover."""
    found = {}
    for frame in fg.load(recipe(name, near)).frames(1):
        light = frame.radiance.mean(axis=2).astype(np.float64).ravel()
        cover = np.zeros(light.shape)
        for rank in range(8):
            is_plant = frame.channel("coverage", f"rank{rank}.id") > 0
            cover += (frame.channel("coverage", f"rank{rank}.coverage") * is_plant).ravel()
        mixture = np.stack([cover, 1.0 - cover], axis=1)
        of_plants = float(np.linalg.lstsq(mixture, light, rcond=None)[0][0])
        found[frame.camera["name"]] = float(light.mean()), of_plants, float(cover.mean())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("species", nargs="+")
    parser.add_argument("--pixel-m", type=float, default=0.003, help="what a pixel covers of every leaf")
    asked = parser.parse_args()

    def all_rows(spec: Any, leaves: Any) -> NDArray[np.bool_]:
        has = [leaves[one] is not None for one in spec.instances.exemplar.tolist()]
        return np.repeat(np.array(has)[:, None], len(spec.cameras), axis=1)

    def every_pixel(cameras: Any, transform: Any, placed: Any, form: Any) -> Floats:
        return np.full(len(placed.node), asked.pixel_m)

    changes = {"_near_rows": all_rows, "_pixels_m": every_pixel, "most_near_triangles": lambda cameras: 40_000_000}
    for name in asked.species:
        pairs = defaultdict(list)
        with patch.multiple(near_foliage, **changes):
            for near in (False, True):
                for view, numbers in measured(name, near).items():
                    pairs[view].append(numbers)
        for view, (far, close) in pairs.items():
            light, plants = (close[k] / far[k] - 1.0 for k in (0, 1))
            print(f"{name:8} {view:10} image {light:+.3f}  plants {plants:+.3f}  cover {far[2]:.3f} -> {close[2]:.3f}")


if __name__ == "__main__":
    main()
