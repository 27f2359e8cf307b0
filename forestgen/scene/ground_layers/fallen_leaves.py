"""Fallen leaves and needles of the stand's own species, dry, greyer and darker with age.

Each species' lie where its crowns are: their share of the ground follows that of the leaf area above within some
metres. Leaves are those of the species file, as they dried: curled along and across, folded, twisted, every second one
face down, every third one with pieces missing. Their colours go from the dry leaf's to the grey of weathered wood, and
some are wet and dark (`_AGES`; shares are ours).

Example
-------
    site: {ground: {kind: litter, layers: [{what: fallen_leaves, cover: 0.8}]}}
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.patches import Patch, bend, copies, join, strip
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.organs.wear import worn
from forestgen.recipe.ground import GroundLayer
from forestgen.recipe.phenology import LeafState
from forestgen.recipe.species import Species
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.ground_layers.layer import (
    GroundLayerKind,
    Layer,
    Request,
    Spread,
    Thing,
    centred,
    mean_surface,
    shades,
    sheet,
)
from forestgen.scene.spec import Material
from forestgen.scene.surfaces import surface_of, wet_spectrum


class _Age(NamedTuple):
    grey: float  # share of the colour that is of weathered wood
    bright: float  # over a leaf just dry
    is_wet: bool = False


_AGES = (
    _Age(0.0, 0.92),
    _Age(0.05, 0.78),
    _Age(0.1, 0.66),
    _Age(0.2, 0.55),
    _Age(0.3, 0.48),
    _Age(0.45, 0.46),
    _Age(0.1, 0.55, is_wet=True),
    _Age(0.25, 0.6, is_wet=True),
)
_FALLEN = "leaves/"  # at the beginning of the names of materials
_EACH = 2  # shapes of an age
_CURL_DEG, _ROLL_DEG, _TWIST_DEG, _FOLD_DEG = 40.0, 55.0, 25.0, 18.0  # standard deviations
_FACE_DOWN, _TORN, _LARGER_BITES = 0.5, 0.25, 1.4
_WRINKLES, _WRINKLE = 5, 0.012  # number, height over the length
_SIZE_SIGMA = 0.25
_WET_GLOSS, _WET_ROUGHNESS = 0.04, 0.3  # a film of water's
_NEEDLE_SHADES = (0.68, 0.95, 1.22, 1.63)  # a floor of them reflects as measured: spectra/ground/litter_needles
_TRAPPED = {"needle": 0.52}  # share of light, by type of leaf: benchmarks/ground_cover.py
_TRAPPED_BY_BLADES = 0.38
_LEAST_SHARE = 0.03  # of the leaf area: rarer species leave nothing that one sees
_FEWEST_TORN = 20  # triangles of a leaf that is drawn so finely that one sees tears
_IN_ONE = 60  # needles that make one thing


class LeavesKeys(GroundLayer):
    """Fallen leaves and needles."""


class Leaves(GroundLayerKind[LeavesKeys]):
    """Fallen leaves."""

    Parameters = LeavesKeys

    def layers(self, keys: LeavesKeys, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        found = []
        for name, (share, where) in request.leaf_share.items():
            species = request.drawn.species.get(name)  # none: a building
            if species is None:
                continue
            key = next((key for key, one in species.materials.items() if one.leaf_type is not None), None)
            if key is None or share < _LEAST_SHARE:
                continue
            dry = surface_of(
                species.materials[key].model_copy(update={"season": None}), LeafState.of_season("dry"), name
            )
            if dry.reflectance_spectrum is None:
                continue
            things = _fallen(request, name, species, key, rng)
            if not things:
                continue
            if species.materials[key].leaf_type == "needle":
                materials = shades(dry, _NEEDLE_SHADES, f"{_FALLEN}{name}")
            else:
                materials = {f"{_FALLEN}{name}-{index}": _aged(dry, age) for index, age in enumerate(_AGES)}
            found.append(
                Layer(
                    name=f"{_FALLEN}{name}",
                    things=things,
                    materials=materials,
                    cover=1.0 - (1.0 - keys.cover) ** share,
                    leaf=mean_surface(list(materials.values())),
                    trapped=_TRAPPED.get(str(species.materials[key].leaf_type), _TRAPPED_BY_BLADES),
                    spread=Spread(tilt_deg=16.0, depth_m=0.02, size_sigma=_SIZE_SIGMA),
                    patch_m=keys.patch_m,
                    where=where,
                )
            )
        return found


def _fallen(request: Request, name: str, species: Species, key: str, rng: np.random.Generator) -> tuple[Thing, ...]:
    """Leaves in a few attitudes and shades."""
    parameters: Any = request.generators[name]
    shapes = [one for one in parameters.shapes.values() if one.material == key]
    if not shapes:
        return ()
    shape = max(shapes, key=lambda one: getattr(one, "length_m", 0.0))
    if hasattr(shape, "needle_length_m") or hasattr(shape, "needles"):
        return _needles(shape, name, rng)
    known, things = type(shape).model_fields, []
    drawn_m = float(getattr(shape, "length_m", 0.1))
    length_m = species.tissue.leaf_length_m or drawn_m
    update = {key: value for key, value in (("curl_deg", 0.0), ("fold_deg", 0.0)) if key in known}
    if "detail" in known:
        update["detail"] = request.detail(length_m)
    form: OrganForm = shape.model_copy(update=update)
    flat = join([one.patch for one in form.patches()])
    flat = flat._replace(points=length_m / drawn_m * flat.points)
    for index in range(_EACH * len(_AGES)):
        shaped = sheet(Part.LITTER, f"{_FALLEN}{name}-{index % len(_AGES)}", _dried(flat, rng))
        things.append(Thing(centred([shaped]), length_m))
    return tuple(things)


def _dried(leaf: Patch, rng: np.random.Generator) -> Patch:
    """A flat leaf along y, as it lies: bent, rolled, folded, twisted, wrinkled, some with pieces missing."""
    curl, roll, twist, fold = np.radians([_CURL_DEG, _ROLL_DEG, _TWIST_DEG, _FOLD_DEG]) * rng.normal(size=4)
    is_down, is_torn = rng.random(2) < (_FACE_DOWN, _TORN)
    if is_torn and len(leaf.faces) >= _FEWEST_TORN:
        leaf = worn(leaf, rng, _LARGER_BITES)
    points = leaf.points
    half_m, length_m = float(np.abs(points[:, 0]).max()), float(np.ptp(points[:, 1]))
    wave = rng.normal(size=(_WRINKLES, 2)) * 6.0 / length_m
    points = points + [0.0, 0.0, _WRINKLE * length_m] * np.sin(
        points[:, :2] @ wave.T + rng.uniform(0.0, 2.0 * np.pi, _WRINKLES)
    ).sum(axis=1, keepdims=True)
    # Both halves about the midrib: |x| goes where `bend` has y.
    side = bend(np.column_stack([points[:, 1], np.abs(points[:, 0]), points[:, 2]]), half_m, roll)
    across = side[:, 1] * np.cos(fold) - side[:, 2] * np.sin(fold)
    points = np.column_stack(
        [np.sign(points[:, 0]) * across, points[:, 1], side[:, 2] * np.cos(fold) + side[:, 1] * np.sin(fold)]
    )
    points = bend(points, length_m, curl, 1.4)
    turn = twist * points[:, 1] / length_m + (np.pi if is_down else 0.0)
    x, z = points[:, 0], points[:, 2]
    turned = np.column_stack([x * np.cos(turn) + z * np.sin(turn), points[:, 1], z * np.cos(turn) - x * np.sin(turn)])
    return leaf._replace(points=turned)


def _aged(dry: Material, age: _Age) -> Material:
    """The surface of a leaf that has lain for some time."""
    fresh, passed = dry.reflectance_spectrum, dry.transmittance_spectrum
    assert fresh is not None  # of all layers
    grey = load_spectra("wood/snag")["reflectance"]
    grid = fresh.wavelength_nm
    reflected = Spectrum(grid, age.bright * (fresh.value + age.grey * (grey.at(grid) - fresh.value)))
    reflected = wet_spectrum(reflected) if age.is_wet else reflected
    if passed is not None:
        passed = Spectrum(passed.wavelength_nm, age.bright * (1.0 - age.grey) * passed.value)
    gloss, roughness = (_WET_GLOSS, _WET_ROUGHNESS) if age.is_wet else (dry.gloss, dry.roughness)
    colours = colours_of_surface(reflected, passed)
    return Material(*colours, roughness, None, gloss, reflected, passed, is_wet=age.is_wet)


def _needles(shape: Any, name: str, rng: np.random.Generator) -> tuple[Thing, ...]:
    """Groups of needles, within a decimetre of each other."""
    length_m = getattr(shape, "needle_length_m", None) or shape.length_m
    width_m = getattr(shape, "needle_width_m", None) or shape.width_m
    things = []
    for index in range(len(_NEEDLE_SHADES)):
        blade = strip(length_m, np.array([width_m, width_m, 0.0]), folded=False)
        turn, lean = rng.random(_IN_ONE) * 2 * np.pi, rng.normal(0.0, 0.2, _IN_ONE)
        at = np.column_stack([rng.normal(0.0, 0.05, (_IN_ONE, 2)), rng.random(_IN_ONE) * 0.006])
        along = np.column_stack([np.cos(turn) * np.cos(lean), np.sin(turn) * np.cos(lean), np.sin(lean)])
        across = np.column_stack([-np.sin(turn), np.cos(turn), np.zeros(_IN_ONE)])
        linear = np.stack([across, along, np.cross(across, along)], axis=-1)
        patch = copies(blade, linear, at)
        things.append(Thing(centred([sheet(Part.LITTER, f"{_FALLEN}{name}-{index}", patch)]), length_m))
    return tuple(things)


LAYER = Leaves()
