"""Veins and decay of leaves: their mean colour, and where they are."""

import numpy as np
import pytest

from forestgen.plants.organs.leaf_texture import LeafLooks, leaf_texture
from forestgen.plants.organs.leaves import LobedLeaf, PalmateLeaf, SimpleLeaf
from forestgen.plants.organs.needles import NeedleTwig

SIZE = {"material": "leaf", "length_m": 0.08, "width_m": 0.05}
FORMS = {
    "simple": SimpleLeaf(form="simple", **SIZE),
    "lobed": LobedLeaf(form="lobed", **SIZE),
    "palmate": PalmateLeaf(form="palmate", **SIZE),
}
COLOUR = (0.2, 0.12, 0.06)


def on_blade(form, texture):
    """(F, 3) colours in the middle of the blade's faces, and their areas' shares."""
    blade = form.flat().sheet(2)
    uv = blade.uv[blade.faces]
    inside = np.random.default_rng(1).dirichlet(np.ones(3), (len(uv), 64))
    u, v = np.einsum("fsc,fck->kfs", inside, uv)
    rows, columns = texture.height_m.shape
    found = texture.colour[(v * rows).astype(int).clip(0, rows - 1), (u * columns).astype(int).clip(0, columns - 1)]
    a, b, c = blade.points[blade.faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return found.mean(axis=1), area / area.sum()


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize("looks", [LeafLooks(), LeafLooks(0.3, 0.2, 0.4)], ids=["live", "decayed"])
def test_the_mean_over_the_blade_is_the_colour(form, looks):
    colour, share = on_blade(form, leaf_texture(form, COLOUR, looks, "test"))
    np.testing.assert_allclose(share @ colour, COLOUR, rtol=0.03)


def test_veins_are_pale_and_their_number_is_that_of_the_lobes():
    texture = leaf_texture(FORMS["lobed"], COLOUR, LeafLooks(mottled=0.0), "test")
    rows, columns = texture.height_m.shape
    red = texture.colour[..., 0]
    assert red[rows // 2, columns // 2] > 1.2 * np.median(red[rows // 2])
    beside = red[int(0.1 * rows) : int(0.8 * rows), columns // 2 + columns // 8]  # along the midrib
    peaks = np.sum((beside[1:-1] > beside[:-2]) & (beside[1:-1] >= beside[2:]) & (beside[1:-1] > 1.05 * np.median(red)))
    assert 3 <= peaks <= FORMS["lobed"].lobes + 1
    np.testing.assert_allclose(red, red[:, ::-1], rtol=1e-5)


def test_patches_of_decay_cover_their_share():
    sound, decayed = (
        leaf_texture(FORMS["simple"], COLOUR, LeafLooks(decayed=share), "test").colour[..., 0] for share in (0.0, 0.3)
    )
    ratio = decayed / sound
    assert 0.2 < np.mean(ratio < 0.6 * ratio.max()) < 0.4


def test_needles_have_no_texture():
    form = NeedleTwig(form="needle_twig", material="needle", length_m=0.2, per_m=100, drawn=4, needle_length_m=0.02)
    assert leaf_texture(form, COLOUR, LeafLooks(), "test") is None
