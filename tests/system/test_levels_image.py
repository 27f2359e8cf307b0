"""Far versions of plants: the image that they give against the image of all detail."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent, Timings
from forestgen.recipe.load import load_recipe_data
from forestgen.render.identity import SceneTracer
from forestgen.render.rendering import render_frame
from forestgen.scene.build import build_scene
from forestgen.scene.plan import make_plan

SPECIES = ("poplar", "spruce", "birch", "maple")
BLOCK = 8


def stand(levels: bool) -> dict[str, object]:
    """32 trees 40 to 180 m from the camera, where far versions are used."""
    plants = [
        {"species": SPECIES[k % 4], "position_m": [8.0 + 9.0 * (k % 8), 50.0 + 42.0 * (k // 8)], "height_m": 12 + k % 5}
        for k in range(32)
    ]
    return {
        "forestgen": 1,
        "seed": 5,
        "site": {"size_m": [90, 200], "terrain": "flat"},
        "species": {name: {"from": name} for name in SPECIES},
        "community": {"model": "placed", "plants": plants},
        "plants": {"exemplars_per_species": 2, "levels": levels, "cache": False},
        "cameras": [{"position_m": [45, 5, 3], "look_at_m": [45, 100, 7], "size_px": [160, 80], "hfov_deg": 50}],
        "render": {"samples": 96, "max_depth": 8, "denoise": False},
        "labels": {"samples": 16, "channels": []},
    }


def rendered(levels: bool, seed: int) -> tuple[NDArray[np.float64], NDArray[np.bool_], int]:
    """Radiance (H, W), where a plant covers anything, triangles of the scene's far exemplars."""
    plan = make_plan(load_recipe_data(stand(levels), "test").draw(0))
    recipe = plan.drawn.recipe
    population = final_population(plan.community, Silent())
    spec = build_scene(plan, population, Silent(), Timings()).spec
    frame = render_frame(SceneTracer(spec, Timings()), spec.cameras[0], recipe, seed, Silent(), Timings())
    triangles = sum(spec.exemplars[i].triangles for i in spec.instances.exemplar)
    return frame.radiance.mean.mean(axis=2), (frame.identity.plant_id > 0).any(axis=2), triangles


def blocks(image: NDArray[np.float64]) -> NDArray[np.float64]:
    h, w = image.shape
    return image.reshape(h // BLOCK, BLOCK, w // BLOCK, BLOCK).mean(axis=(1, 3))


@pytest.mark.slow
def test_far_versions_do_not_change_the_image_visibly() -> None:
    full, covered, most = rendered(False, 1)
    again, _, _ = rendered(False, 2)
    far, still_covered, fewer = rendered(True, 3)
    assert fewer < 0.9 * most
    scale = blocks(full)
    noise = float(np.sqrt(np.mean(((blocks(again) - scale) / scale) ** 2)))
    change = float(np.sqrt(np.mean(((blocks(far) - scale) / scale) ** 2)))
    bias = float(far[covered].mean() / full[covered].mean() - 1.0)
    share = float(still_covered.mean() / covered.mean() - 1.0)
    sys.stdout.write(
        f"triangles {fewer / most:.2f} of all; 8 x 8 blocks differ by {change:.4f}, noise {noise:.4f}; "
        f"mean {bias:+.4f}; covered pixels {share:+.4f}\n"
    )
    assert abs(bias) < 0.01
    assert change < 0.02 + 1.5 * noise
    assert abs(share) < 0.02
