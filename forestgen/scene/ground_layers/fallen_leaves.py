"""Fallen leaves and needles of the stand's own species: some curled and dry on top, more flat, dark and wet below.

Each species' lie where its crowns are: their share of the ground follows that of the leaf area above within some
metres. Leaves are those of the species file, as they dried: curled along and across, folded, twisted, wavy, every
second one face down, every fifth one with bites, a few in pieces. Their colours go from the dry leaf's, in
autumn with that of leaves that fell lately, to deeper browns and the grey of weathered wood; older ones are flat, wet,
and dark in patches (`_AGES`; shares are ours). Near a camera they show veins (`plants/organs/leaf_texture.py`).

On litter, where some camera sees leaves of 45 mm or more at least ten pixels long, older ones lie below in the gaps, as
far as a texel of the ground's paint is more than a pixel: flat, eaten, in pieces, with twigs between them, once for all
sections of a recipe, not on paths and water. They are as bright as the painted litter, in the mean, but without its
green of moss.

Example
-------
    site: {ground: {kind: litter, layers: [{what: fallen_leaves, cover: 0.8}]}}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Floats
from forestgen.geometry.patches import Patch, bend, copies, join, strip
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.organs.leaf_texture import LeafLooks, leaf_texture
from forestgen.plants.organs.wear import piece, worn
from forestgen.recipe.ground import GroundLayer
from forestgen.recipe.phenology import LeafState, fallen_lately
from forestgen.recipe.registries import GROUND_COVERS
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
    opaque,
    shades,
    sheet,
)
from forestgen.scene.ground_layers.twigs import twig
from forestgen.scene.grounds.litter import Litter
from forestgen.scene.spec import Material
from forestgen.scene.surfaces import surface_of, wet_spectrum
from forestgen.scene.terrain import TEXTURE_PX, TEXTURE_TILE_M, GroundCover


class _Age(NamedTuple):
    bright: float  # over a leaf just dry
    deep: float  # more of its pigments: power of its reflectance, less 1
    grey: float  # share of the colour that is of weathered wood
    decayed: float = 0.0  # share of the blade in dark patches
    rise: float = 1.0  # how far it is curled, and lies on others
    is_wet: bool = False
    shapes: int = 3


# Measured leaf litters (earthlib) reflect 0.30 to 0.49 at 450 nm of what they do at 650 nm; these, 0.29 to 0.59.
_AGES = (
    _Age(1.2, -0.05, 0.15, 0.02),
    _Age(1.15, 0.08, 0.12, 0.03, shapes=4),
    _Age(0.65, 0.12, 0.08, 0.05, shapes=4),
    _Age(0.85, 0.3, 0.1, 0.15, 0.9),
    _Age(0.8, 0.0, 0.55, 0.12, 0.6),
    _Age(0.55, 0.1, 0.5, 0.2, 0.3),
    _Age(0.7, 0.35, 0.1, 0.3, 0.2),
    _Age(0.7, 0.4, 0.1, 0.2, 0.15, is_wet=True),
    _Age(0.45, 0.35, 0.2, 0.45, 0.1, is_wet=True, shapes=4),
)
# Leaves below: brightness over the mean, and `_Age.deep`.
_OLD = ((0.25, 0.5), (0.5, 0.2), (0.9, 0.6), (1.2, 0.1), (2.1, 0.2))
_FALLEN = "leaves/"  # at the beginning of the names of materials
_IN_DECAY = 0.3  # brightness of decayed patches over sound ones, about
_CURL_DEG, _ROLL_DEG, _TWIST_DEG, _FOLD_DEG = 50.0, 60.0, 25.0, 22.0  # standard deviations on top
_FLATTEST = 0.12  # of these, of leaves below others
_FACE_DOWN, _TORN, _IN_PIECES, _LARGER_BITES = 0.5, 0.2, 0.15, 1.4
_WRINKLES, _WRINKLE = 5, 0.012  # number, height over the length
_WAVES, _WAVE = 6.0, 0.05  # of the margin, height over the half-width
_RELIEF, _MOTTLED = 0.28, 0.16  # of veins of dry leaves, and of their tone
_SIZE_SIGMA = 0.25
_WET_GLOSS, _WET_ROUGHNESS = 0.04, 0.3  # a film of water's
_NEEDLE_SHADES = (0.68, 0.95, 1.22, 1.63)  # a floor of them reflects as measured: spectra/ground/litter_needles
_TRAPPED = {"needle": 0.52}  # share of light, by type of leaf: benchmarks/ground_cover.py
_TRAPPED_BY_BLADES = 0.33
_HEAPED_M, _BLADES_HEAPED_M = {"needle": 0.08}, 0.16  # against stems
_LEAST_SHARE = 0.03  # of the leaf area: rarer species leave nothing that one sees
_TEXTURED = 10.0  # pixels that a leaf covers that shows veins
_FEWEST_TORN = 20  # triangles of a leaf that is drawn so finely that one sees tears
_IN_ONE = 60  # needles that make one thing
_BELOW = "below"  # at the end of the name of the layer of older leaves
_BELOW_COVER, _BELOW_DEPTH_M, _BELOW_TILT_DEG, _BELOW_SIGMA = 0.9, 0.006, 7.0, 0.3
_BELOW_FROM_M, _BELOW_PIECE_M = 0.045, 0.065  # least leaf, and piece before it tears: there would be too many
_INFRARED_NM, _INFRARED = (650.0, 750.0), 0.25  # where older leaves become alike, and share of the differences left
_BRIGHTEST = 0.9
_BELOW_RISE, _OLD_GREY, _MIDDLE_NM = 0.25, 0.15, 600.0
# Whether each is a piece, and its size over the leaf's.
_BELOW_PIECES = (
    *((False, 1.0), (True, 1.0), (True, 0.7), (True, 0.4), (False, 0.8)),
    *((True, 1.0), (True, 0.6), (False, 0.9), (True, 0.8)),
)
_BELOW_TWIG_M = 0.07


class LeavesKeys(GroundLayer):
    """Fallen leaves and needles."""


class Leaves(GroundLayerKind[LeavesKeys]):
    """Fallen leaves."""

    Parameters = LeavesKeys
    most_triangles = 1_500_000

    def layers(self, keys: LeavesKeys, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        found, seen_near = [], []
        for name, (share, where) in request.leaf_share.items():
            species = request.drawn.species.get(name)  # none: a building
            if species is None:
                continue
            key = next((key for key, one in species.materials.items() if one.leaf_type is not None), None)
            if key is None or share < _LEAST_SHARE:
                continue
            fresh = fallen_lately(species.phenology, request.drawn.recipe.time_of_year)
            dry, lately = (
                surface_of(
                    species.materials[key].model_copy(update={"season": None}),
                    LeafState(spectra=(0.0, 0.0, share, 1.0 - share)),
                    name,
                )
                for share in (0.0, fresh)
            )
            if dry.reflectance_spectrum is None:
                continue
            shape = _shape_of(request, name, key)
            if shape is None:
                continue
            if species.materials[key].leaf_type == "needle":
                things, materials = _needles(shape, name, rng), shades(dry, _NEEDLE_SHADES, f"{_FALLEN}{name}")
            else:
                length_m = species.tissue.leaf_length_m or float(getattr(shape, "length_m", 0.1))
                things = _fallen(shape, name, length_m, request.detail(length_m), rng)
                near = shape if length_m > _TEXTURED * request.pixel_m else None
                if near is not None and length_m >= _BELOW_FROM_M:
                    seen_near.append((_flat(shape, length_m, detail=1), dry.reflectance_spectrum))
                materials = {
                    f"{_FALLEN}{name}-{index}": _aged(lately if age.rise == 1.0 else dry, age, near, f"{name}-{index}")
                    for index, age in enumerate(_AGES)
                }
            cover = 1.0 - (1.0 - keys.cover) ** share
            found.append(
                Layer(
                    name=f"{_FALLEN}{name}",
                    things=things,
                    materials=materials,
                    cover=cover,
                    leaf=mean_surface(list(materials.values()), _seen(things, list(materials), cover)),
                    trapped=_TRAPPED.get(str(species.materials[key].leaf_type), _TRAPPED_BY_BLADES),
                    spread=Spread(tilt_deg=20.0, depth_m=0.025, size_sigma=_SIZE_SIGMA),
                    patch_m=keys.patch_m,
                    where=where,
                    heaped_m=_HEAPED_M.get(str(species.materials[key].leaf_type), _BLADES_HEAPED_M),
                )
            )
        below = _older(seen_near, request, rng) if _is_first(keys, request) else None
        return found if below is None else [below, *found]


def _is_first(keys: LeavesKeys, request: Request) -> bool:
    """Whether these are the first leaves of the recipe that lie on the ground, neither on paths nor on water."""
    sections = request.drawn.recipe.site.ground.layers
    on_ground = [one for one in sections if isinstance(one, LeavesKeys) and one.on == "ground"]
    return keys.on == "ground" and keys is (on_ground or [keys])[0]


def _older(leaves: Sequence[tuple[Patch, Spectrum]], request: Request, rng: np.random.Generator) -> Layer | None:
    """What lies between leaves that are seen well: older ones, in pieces; None: on no litter, or without such leaves.

    `leaves`: flat, and the reflectance of dry ones, by species.
    """
    ground: GroundCover = GROUND_COVERS.load(request.drawn.recipe.site.ground.kind)
    if not leaves or not isinstance(ground, Litter):
        return None
    names, things = [f"{_FALLEN}{_BELOW}-{index}" for index in range(len(_OLD))], []
    for leaf, _ in leaves:
        for number, (is_torn, size) in enumerate(_BELOW_PIECES):
            old = _dried(leaf, _BELOW_RISE, rng, is_torn=is_torn)
            size = max(size, min(_BELOW_PIECE_M / float(np.ptp(leaf.points[:, 1])), 1.0))
            old = old._replace(points=size * old.points)
            things.append(_lying(old, names[number % len(names)]))
    things.append(replace(_lying(twig(_BELOW_TWIG_M, rng), names[1]), closed=True))
    grid = leaves[0][1].wavelength_nm
    dry = np.mean([one.at(grid) for _, one in leaves], axis=0)
    grey = load_spectra("wood/snag")["reflectance"].at(grid)
    tones = np.array([bright * (dry ** (1.0 + deep) + _OLD_GREY * grey) for bright, deep in _OLD])
    mean = np.average(tones, axis=0, weights=_seen(things, names, _BELOW_COVER))
    floor, p = ground.reflectance().at(grid), _TRAPPED_BY_BLADES
    equal = floor / (1.0 - p + p * floor) / mean  # with this scale `Layer.spectrum` is the floor's
    # But moss makes that green: so where the eye sees, the scale is that of one wavelength.
    one_scale = float(np.interp(_MIDDLE_NM, grid, equal))
    infrared = np.clip((grid - _INFRARED_NM[0]) / np.ptp(_INFRARED_NM), 0.0, 1.0)
    scale = one_scale + (equal - one_scale) * infrared
    # There dead leaves are more alike: pigments and their decay change them little.
    tones = np.minimum(scale * (mean + (1.0 - (1.0 - _INFRARED) * infrared) * (tones - mean)), _BRIGHTEST)
    return Layer(
        name=f"{_FALLEN}{_BELOW}",
        things=tuple(things),
        materials={name: opaque(Spectrum(grid, one)) for name, one in zip(names, tones, strict=True)},
        cover=_BELOW_COVER,
        leaf=opaque(Spectrum(grid, scale * mean)),
        trapped=p,
        spread=Spread(_BELOW_TILT_DEG, _BELOW_DEPTH_M, _BELOW_SIGMA),
        is_painted=False,
    )


def _lying(patch: Patch, material: str) -> Thing:
    """A thing below leaves, drawn where a texel of the paint is more than a pixel."""
    return Thing(centred([sheet(Part.LITTER, material, patch)]), TEXTURE_TILE_M / TEXTURE_PX)


def _seen(things: Sequence[Thing], materials: Sequence[str], cover: float) -> Floats:
    """(M,) share of each material in what is seen from above: things of height z below a share F(z) of the others' area
    are seen by exp(-F(z) t), where all of them hide 1 - exp(-t) of the ground.
    """
    area, rise = np.array([[one.hidden_m2, one.rise] for one in things]).T
    z = rise[:, None] * (np.arange(32) + 0.5) / 32
    above = np.clip(1.0 - z[..., None] / rise, 0.0, 1.0) @ area / area.sum()
    seen = area * np.exp(above * np.log1p(-min(cover, 0.999))).mean(axis=1)
    of = np.array([materials.index(one.organs[0].material) for one in things])
    return np.bincount(of, seen, minlength=len(materials)).astype(np.float64)


def _shape_of(request: Request, name: str, key: str) -> Any:
    """The largest form of a species' leaves of a material; None: it has none."""
    shapes = [one for one in request.generators[name].shapes.values() if one.material == key]
    return max(shapes, key=lambda one: getattr(one, "length_m", 0.0), default=None)


def _flat(shape: Any, length_m: float, detail: int) -> Patch:
    """A species' leaf of a length, without fold and curl."""
    known = type(shape).model_fields
    update: dict[str, float] = {key: 0.0 for key in ("curl_deg", "fold_deg") if key in known}
    if "detail" in known:
        update["detail"] = detail
    form: OrganForm = shape.model_copy(update=update)
    flat = join([one.patch for one in form.patches()])
    return flat._replace(points=length_m / float(getattr(shape, "length_m", 0.1)) * flat.points)


def _fallen(shape: Any, name: str, length_m: float, detail: int, rng: np.random.Generator) -> tuple[Thing, ...]:
    """Leaves of all ages, each in some attitudes."""
    things, flat = [], _flat(shape, length_m, detail)
    for index, age in enumerate(_AGES):
        for _ in range(age.shapes):
            shaped = sheet(Part.LITTER, f"{_FALLEN}{name}-{index}", _dried(flat, age.rise, rng))
            things.append(Thing(centred([shaped]), length_m, rise=age.rise))
    return tuple(things)


def _dried(leaf: Patch, rise: float, rng: np.random.Generator, *, is_torn: bool = False) -> Patch:
    """A flat leaf along y, as it lies: bent, rolled, folded, twisted, wrinkled, some with pieces missing.

    `rise`: 1: as on top; 0: as flat as below others. `is_torn`: a piece of it in any case.
    """
    bends = np.radians([_CURL_DEG, _ROLL_DEG, _TWIST_DEG, _FOLD_DEG]) * (_FLATTEST + (1.0 - _FLATTEST) * rise)
    curl, roll, twist, fold = bends * rng.normal(size=4)
    is_down, is_eaten, is_piece = rng.random(3) < (_FACE_DOWN, _TORN, _IN_PIECES * (1.5 - rise))
    if is_torn or (is_piece and len(leaf.faces) >= _FEWEST_TORN):
        leaf = piece(leaf, rng)
    elif is_eaten and len(leaf.faces) >= _FEWEST_TORN:
        leaf = worn(leaf, rng, _LARGER_BITES)
    points = leaf.points
    half_m, length_m = float(np.abs(points[:, 0]).max()), float(np.ptp(points[:, 1]))
    wave = rng.normal(size=(_WRINKLES, 2)) * 6.0 / length_m
    points = points + [0.0, 0.0, _WRINKLE * length_m] * np.sin(
        points[:, :2] @ wave.T + rng.uniform(0.0, 2.0 * np.pi, _WRINKLES)
    ).sum(axis=1, keepdims=True)
    phase = 2.0 * np.pi * _WAVES * points[:, 1] / length_m + np.where(points[:, 0] > 0.0, 0.0, 2.0)
    points[:, 2] += _WAVE * np.abs(points[:, 0]) * np.sin(phase)
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


def _aged(dry: Material, age: _Age, near: OrganForm | None, name: str) -> Material:
    """The surface of a leaf that has lain for some time; `near`: its form, of which veins are seen."""
    fresh, passed = dry.reflectance_spectrum, dry.transmittance_spectrum
    assert fresh is not None  # of all layers
    grey = load_spectra("wood/snag")["reflectance"]
    grid, bright = fresh.wavelength_nm, age.bright * (1.0 - (1.0 - _IN_DECAY) * age.decayed)
    deep = fresh.value ** (1.0 + age.deep)
    reflected = Spectrum(grid, bright * (deep + age.grey * (grey.at(grid) - deep)))
    reflected = wet_spectrum(reflected) if age.is_wet else reflected
    if passed is not None:
        through = bright * (1.0 - age.grey) * passed.value ** (1.0 + age.deep)
        passed = Spectrum(passed.wavelength_nm, np.minimum(through, 1.0 - reflected.at(passed.wavelength_nm)))
    gloss, roughness = (_WET_GLOSS, _WET_ROUGHNESS) if age.is_wet else (dry.gloss, dry.roughness)
    colours = colours_of_surface(reflected, passed)
    looks = LeafLooks(_RELIEF, _MOTTLED, age.decayed)
    texture = None if near is None else leaf_texture(near, colours[0], looks, name)
    return Material(*colours, roughness, texture, gloss, reflected, passed, is_wet=age.is_wet)


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
