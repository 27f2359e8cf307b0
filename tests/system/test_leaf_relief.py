"""Leaves whose surface has a relief, such as veins: lit as Mitsuba lights them, and as bright as without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_paths import assert_same, by_mitsuba, images_of, white_sky

from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.scene.colour import RGB
from forestgen.scene.spec import Material, SceneSpec, Sky
from support.bark_post import REFLECTANCE, leaning_texture, post_scene


def leaf_post(height_m: float, leaf: Material) -> SceneSpec:
    """The post as a leaf: from above its upper end its inner side is seen, the leaf's lower side."""
    spec, eye = post_scene(leaf, part=Part.LEAF), (0.0, -6.0, height_m)
    view = replace(spec.cameras[0], position_m=eye, world_from_camera=look_at(eye, (0.0, 0.0, 1.0)))
    return replace(spec, sky=Sky(30.0, 200.0, 3.0), cameras=(view,))


@pytest.mark.parametrize("height_m", [1.0, 6.0])
@pytest.mark.slow
def test_veins_of_leaves_are_lit_as_mitsuba_lights_them_from_both_sides(height_m):
    leaf = Material(REFLECTANCE, roughness=0.4, texture=leaning_texture((0.4, 0.3)), gloss=0.03)
    spec = leaf_post(height_m, leaf)
    assert_same(images_of(spec, 10, 64), by_mitsuba(spec, 10, 64))


@pytest.mark.slow
def test_the_relief_of_leaves_keeps_their_light():
    """Under a white sky, whatever they let through; slopes are those of dry leaves."""
    for height_m in (1.0, 6.0):
        means = []
        for lean in ((0.0, 0.0), (0.22, 0.17)):
            leaf = Material(REFLECTANCE, (0.4, 0.3, 0.2), 0.4, leaning_texture(lean), gloss=0.03)
            lit = white_sky(leaf_post(height_m, leaf))
            lit.show(RGB)
            found = lit.take(256, seed=1)
            means.append((found.by_sky + found.beyond).mean(axis=(0, 1)))
        np.testing.assert_allclose(means[1], means[0], rtol=0.01)
