"""What surfaces do with light, and their BSDFs for Mitsuba, which change when a pass is for other wavelengths.

`surface_of` describes the surface of an organ. `surface_bsdf` turns it into a BSDF for Mitsuba's integrators, and
`paths/scattering.py` into tables for the light paths; tests/system/test_paths.py compares the two.

The gloss of a leaf's skin
--------------------------
A tabled reflectance is one number: what an integrating sphere measured under light from 8 degrees. So that a leaf with
a gloss has that reflectance under any light, the gloss must take the same share of it everywhere. A rough mirror of
index n has two tendencies: Fresnel's reflectance rises toward grazing light, and the facets' shadows take it away
again. For each roughness there is an index at which they cancel: light from 8 degrees, and light from the whole
hemisphere, lose the same share to it. In between the share varies by 2% of itself up to 60 degrees, and by 6%
up to 75. That index is above that of wax (1.45), so the highlight of grazing light is weaker than a wet leaf's.

References
----------
Walter et al. 2007, "Microfacet models for refraction through rough surfaces": GGX, eqs. 33 and 34.
Heitz 2018, "Sampling the GGX distribution of visible normals".
Burley 2012, "Physically based shading at Disney": alpha = roughness².
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.render.variant import mi
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import Material, Terrain
from forestgen.scene.surfaces import film_factor, ground_texture

Floats = NDArray[np.float64]
SPHERE_DEG = 8.0  # from which an integrating sphere is lit
LEAST_ROUGHNESS, MOST_ROUGHNESS = 0.2, 0.7  # below, highlights are specks of noise; above, no index fits
_GRID = 64  # points along each side of the square that is mapped to visible facets
_RINGS = 12  # of the hemisphere
LEAFLIKE = (Part.LEAF, Part.FLOWER, Part.LITTER, Part.GROUND_PLANTS, Part.MOSS)  # seen from both sides
Recipe = Callable[[Channels], dict[str, Any]]


@dataclass(frozen=True)
class Gloss:
    """A rough mirror whose albedo hardly depends on the angle."""

    alpha: float  # width of the GGX distribution of facets
    index: float  # of refraction
    albedo: float  # directional, of light from 8 degrees; of light from the whole hemisphere the same
    highest: float  # largest directional albedo, which grazing light meets, over `albedo`


@lru_cache(maxsize=256)
def gloss_of(roughness: float) -> Gloss:
    """The lobe of a perceptual roughness, as mesh files have it: the facets' width is its square."""
    from scipy.optimize import brentq

    alpha = float(np.clip(roughness, LEAST_ROUGHNESS, MOST_ROUGHNESS)) ** 2
    node, weight = np.polynomial.legendre.leggauss(_RINGS)
    rings = [_reflected(cosine, alpha) for cosine in np.sqrt((node + 1) / 2)]  # 2 cos dcos = d(cos²)
    sphere = _reflected(np.cos(np.radians(SPHERE_DEG)), alpha)

    def excess(index: float) -> float:
        hemisphere = float(sum(w / 2 * _albedo(ring, index) for w, ring in zip(weight, rings, strict=True)))
        return hemisphere - _albedo(sphere, index)

    index = float(brentq(excess, 1.2, 50.0, xtol=1e-5))
    albedo = _albedo(sphere, index)
    grazing = [_albedo(_reflected(np.cos(np.radians(angle)), alpha), index) for angle in np.arange(70.0, 90.0, 0.5)]
    return Gloss(alpha, index, albedo, max(1.0, *(value / albedo for value in grazing)))


def _reflected(cosine: float, alpha: float) -> tuple[Floats, Floats]:
    """Cosine between light and facet, and weight times share that leaves unshadowed: (N,), visible facets."""
    rest, second = np.meshgrid(*[(np.arange(_GRID) + 0.5) / _GRID] * 2)
    first, weight = 1.0 - rest**3, 3.0 * rest**2  # denser where facets are steep: there the shadows begin
    light = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    view = light * [alpha, 1.0, 1.0]
    view /= np.linalg.norm(view)
    across = np.array([0.0, 1.0, 0.0])
    along = np.cross(view, across)
    radius, angle = np.sqrt(first), 2 * np.pi * second
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    share = 0.5 * (1.0 + view[2])
    # Heitz: `across` spans the disc's half that is never foreshortened.
    y = (1.0 - share) * np.sqrt(1.0 - x**2) + share * y
    z = np.sqrt(np.maximum(0.0, 1.0 - x**2 - y**2))
    facet = x[..., None] * across + y[..., None] * along + z[..., None] * view
    facet *= [alpha, alpha, 1.0]
    facet /= np.linalg.norm(facet, axis=-1, keepdims=True)
    to_facet = facet @ light
    up = 2 * to_facet * facet[..., 2] - light[2]
    safe = np.clip(up, 1e-9, 1.0)
    lit = 2.0 / (1.0 + np.sqrt(1.0 + alpha**2 * (1.0 / safe**2 - 1.0)))
    return to_facet.ravel(), (weight * np.where(up > 0, lit, 0.0)).ravel()


def _albedo(reflected: tuple[Floats, Floats], index: float) -> float:
    """Mean of Fresnel's reflectance for unpolarised light over the visible facets."""
    cosine, lit = reflected
    inner = np.sqrt(1.0 - (1.0 - cosine**2) / index**2)
    across = (cosine - index * inner) / (cosine + index * inner)
    along = (index * cosine - inner) / (index * cosine + inner)
    return float(np.mean(0.5 * (across**2 + along**2) * lit))


@dataclass
class SpectralBsdfs:
    """The BSDFs of a scene, and its emitters: built once, and given the values of other channels between passes."""

    channels: Channels = RGB
    _made: list[tuple[Any, Recipe]] = field(default_factory=list)
    _plants: dict[tuple[int, bool, bool], Any] = field(default_factory=dict)

    def plant(self, part: Part, material: Material, *, has_uv: bool) -> Any:
        """BSDF of a plant's surface; one for all meshes of a material, which its recipe keeps alive."""
        key = (id(material), part in LEAFLIKE, has_uv)
        if key not in self._plants:
            self._plants[key] = self.add(lambda channels: surface_bsdf(part, material, channels, has_uv=has_uv))
        return self._plants[key]

    def ground(self, terrain: Terrain) -> Any:
        """BSDF of the ground."""
        return self.add(lambda channels: ground_bsdf(terrain, channels))

    def add(self, recipe: Recipe) -> Any:
        """A BSDF or emitter that is made, and later repainted, by a function of the channels to a dictionary."""
        # Unoptimised: lobes that happen to be equal in one pass must not become one object for all.
        made = mi.load_dict(recipe(self.channels), optimize=False)
        self._made.append((made, recipe))
        return made

    def repaint(self, channels: Channels) -> None:
        """Give all objects the values of other channels, in place: scenes that hold them need no new building."""
        if channels == self.channels:
            return
        for made, recipe in self._made:
            repaint(made, mi.load_dict(recipe(channels), optimize=False))
        self.channels = channels


def repaint(old: Any, new: Any) -> None:
    """Copy the parameters of one Mitsuba object to another that was made alike."""
    scalar = mi.variant().startswith("scalar")  # where an array's `numpy` is the array itself and no copy
    target, source = mi.traverse(old), mi.traverse(new)
    for key in target.keys():  # noqa: SIM118 - no mapping of Python's
        fresh, kept = source[key], target[key]
        if scalar and hasattr(fresh, "numpy") and np.ndim(fresh) and np.shape(fresh) == np.shape(kept):
            # The renderer's own memory: an assignment goes element by element, a hundred times slower on a texture.
            np.copyto(kept.numpy(), fresh.numpy())
            target.set_dirty(key)
        else:
            target[key] = fresh
    target.update()


@dataclass(frozen=True)
class Sides:
    """What a surface does with light, by channel: all of it adds up to at most 1."""

    matt: NDArray[np.float64]  # (3,) reflected evenly in all directions
    gloss: float  # reflected about the mirror's direction, the same in all channels
    through: NDArray[np.float64]  # (3,) let through evenly

    @property
    def shares(self) -> tuple[float, float]:
        """Share of paths that go through, and of those that do not, the share that the gloss throws back."""
        back = float(self.matt.max()) + self.gloss
        through = float(self.through.max())
        total = back + through
        return (through / total if total > 0 else 0.5), (self.gloss / back if back > 0 else 0.5)


def sides_of(material: Material, channels: Channels) -> Sides:
    """Reflectance and transmittance of a material, the gloss taken out of the reflectance."""
    reflectance = channels.of_surface(material.reflectance, material.reflectance_spectrum)
    transmittance = channels.of_surface(material.transmittance, material.transmittance_spectrum)
    # The colours of a saturated spectrum may add up to more than the spectra themselves.
    excess = np.maximum(reflectance + transmittance, 1.0)
    gloss = gloss_share(material)
    return Sides(np.maximum(reflectance / excess - gloss, 0.0), gloss, transmittance / excess)


def gloss_share(material: Material) -> float:
    """Reflectance of a material's gloss: at most its reflectance in any channel, whichever these are.

    The gloss of leaves is the same at all wavelengths (Bousquet et al. 2005), so the darkest one sets the limit. Nor
    may grazing light, of which the gloss takes a little more, find a leaf that returns more than it gets: a leaf that
    absorbs nothing has no gloss.
    """
    if material.gloss <= 0:
        return 0.0
    reflectance, transmittance = np.asarray(material.reflectance), np.asarray(material.transmittance)
    darkest, brightest = float(reflectance.min()), float((reflectance + transmittance).max())
    one, other = material.reflectance_spectrum, material.transmittance_spectrum
    if one is not None:
        grid = one.wavelength_nm if other is None else np.union1d(one.wavelength_nm, other.wavelength_nm)
        through = 0.0 if other is None else other.at(grid)
        darkest = min(darkest, float(one.value.min()))
        brightest = max(brightest, float(np.max(one.at(grid) + through)))
    room = (1.0 - brightest) / (gloss_of(material.roughness).highest - 1.0 + 1e-9)
    return float(max(min(material.gloss, darkest, room), 0.0))


def _unbounded(colour: NDArray[np.floating], share: float) -> dict[str, Any]:
    """A lobe's colour over its share of the paths: a reflectance that may pass 1."""
    return {"type": "srgb", "color": (colour / max(share, 1e-9)).tolist(), "unbounded": True}


@dataclass(frozen=True)
class Surface:
    """An organ's surface in the channels of a pass. Only the numbers of `sides` depend on the channels."""

    sides: Sides
    lobe: Gloss | None  # of the gloss; None: there is none
    transmits: bool
    textured: bool  # reflects `relief_colour` in place of the matt colour, by facets that lean as the texture's normals


def is_textured(material: Material, *, has_uv: bool) -> bool:
    """Whether an organ shows its material's texture, which needs a mesh with uv."""
    return material.texture is not None and has_uv


def surface_of(part: Part, material: Material, channels: Channels, *, has_uv: bool) -> Surface:
    """The surface of an organ. Wood lets no light through."""
    textured = is_textured(material, has_uv=has_uv)
    if part not in LEAFLIKE:
        material = replace(material, transmittance=(0.0, 0.0, 0.0), transmittance_spectrum=None)
    is_glossy = (part in LEAFLIKE or not textured) and gloss_share(material) > 0
    lobe = gloss_of(material.roughness) if is_glossy else None
    spectrum = material.transmittance_spectrum
    transmits = max(material.transmittance) > 0 or (spectrum is not None and float(spectrum.value.max()) > 0)
    return Surface(sides_of(material, channels), lobe, transmits, textured)


def surface_bsdf(part: Part, material: Material, channels: Channels = RGB, *, has_uv: bool = False) -> dict[str, Any]:
    """BSDF of an organ's surface: a matt and a glossy reflector, alike on both sides, and a matt transmitter.

    R and T are the material's for light from 8 degrees and from the whole hemisphere; without gloss, and T always, for
    light from any direction. tests/system/test_leaf.py integrates them. `principledthin` with diff_trans 2 lets its
    colour through, evenly in all directions, and reflects nothing.

    Each lobe is chosen as often as its share of the light, and carries the light over that share. So its colour
    may pass 1, and nothing is clipped or lost, whichever channels are large.
    """
    surface = surface_of(part, material, channels, has_uv=has_uv)
    colour = relief_colour(material, surface, channels) if surface.textured else surface.sides.matt
    normals = material.texture.normals() if surface.textured and material.texture is not None else None
    if not surface.transmits:
        return _reflector(surface, 1.0, colour, normals)
    share = surface.sides.shares[0]
    return {
        "type": "blendbsdf",
        "weight": share,
        "r": _reflector(surface, 1.0 - share, colour, normals),
        "t": {"type": "principledthin", "base_color": _unbounded(surface.sides.through, share), "diff_trans": 2.0},
    }


def _reflector(
    surface: Surface, share: float, colour: NDArray[np.floating], normals: NDArray[np.float32] | None
) -> dict[str, Any]:
    """What a surface of a matt colour reflects, on both sides, over a share of the paths."""
    sides, lobe = surface.sides, surface.lobe
    glossy = sides.shares[1] if lobe is not None else 0.0
    matt = colour / max(share * (1.0 - glossy), 1e-9)
    faces = [_matt(matt, normals, side) for side in ((1.0, -1.0) if normals is not None else (1.0,))]
    if lobe is not None:
        mirror = {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": lobe.alpha,
            "eta": lobe.index,
            "k": 0.0,
            "specular_reflectance": _unbounded(np.full(3, sides.gloss / lobe.albedo), share * glossy),
        }
        faces = [{"type": "blendbsdf", "weight": glossy, "d": one, "g": mirror} for one in faces]
    return {"type": "twosided", **{f"side{k}": one for k, one in enumerate(faces)}}


def _matt(colour: NDArray[np.floating], normals: NDArray[np.float32] | None, side: float) -> dict[str, Any]:
    """A diffuse surface; with a relief, seen from above (side 1) or from below (-1)."""
    if normals is None:
        return {"type": "diffuse", "reflectance": _unbounded(colour, 1.0)}
    return {
        "type": "normalmap",
        "use_shadowing_function": False,  # the facets' colours already contain the terminator's shading
        "normalmap": _bitmap(0.5 + 0.5 * normals * np.array([side, side, 1.0], np.float32)),
        "bsdf": {"type": "diffuse", "reflectance": _bitmap(colour)},
    }


def relief_colour(material: Material, surface: Surface, channels: Channels) -> NDArray[np.floating]:
    """(H, W, 3) colour of the facets of a material with a texture.

    Under a sky that is equally bright everywhere, a facet that leans from the surface by an angle a gets only
    (1 + cos a) / 2 of what the surface gets: the rest of its hemisphere lies below the surface. What it misses there
    would come from the facet opposite. The colour is divided by that share, so that the mean reflectance stays the
    texture's own, less the gloss. Of a thin leaf, no texel reflects more than the leaf does not let through.
    """
    assert material.texture is not None
    seen = 0.5 + 0.5 * material.texture.normals()[..., 2:]
    mean = channels.of_surface(material.reflectance, material.reflectance_spectrum)
    most = seen[..., 0] * max(1.0 - float(surface.sides.through.max()), float(mean.max()))
    colour = channels.texture(material.texture.colour, material.reflectance, material.reflectance_spectrum, most)
    matt = surface.sides.matt / np.maximum(mean, 1e-9) if surface.lobe is not None else 1.0
    return np.asarray(colour * matt / seen)


def _bitmap(image: NDArray[Any]) -> dict[str, Any]:
    """A texture of linear values, row 0 at v = 0, that repeats."""
    bitmap = mi.Bitmap(np.ascontiguousarray(image, dtype=np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat", "format": "fp16"}


def ground_bsdf(terrain: Terrain, channels: Channels = RGB) -> dict[str, Any]:
    """Diffuse ground: the terrain's texture on the site, other grounds in places, darker where it is wet, one colour in
    the distance.
    """
    near = _in_patches(terrain, channels)
    if terrain.wet is not None:
        film = film_factor(terrain, channels).astype(np.float32)
        near = {
            "type": "blendbsdf",
            "weight": {"type": "mesh_attribute", "name": "vertex_wet_share"},
            "dry": near,
            "wet": _in_patches(terrain, channels, film),
        }
    far_share = {"type": "mesh_attribute", "name": "vertex_far_share"}
    far_colour = channels.of_surface(terrain.far_reflectance, terrain.far_spectrum).tolist()
    far = {"type": "diffuse", "reflectance": {"type": "rgb", "value": far_colour}}
    return {"type": "twosided", "bsdf": {"type": "blendbsdf", "weight": far_share, "near": near, "far": far}}


def _in_patches(terrain: Terrain, channels: Channels, film: NDArray[np.float32] | float = 1.0) -> dict[str, Any]:
    """A ground with its patches of other grounds."""
    ground = _painted_ground(np.asarray(ground_texture(terrain, channels) * film, dtype=np.float32))
    for index, patch in enumerate(terrain.overlays):
        colour = ground_texture(patch, channels) * film
        ground = {
            "type": "blendbsdf",
            "weight": {"type": "mesh_attribute", "name": f"vertex_patch_share_{index}"},
            "around": ground,
            "patch": _painted_ground(np.asarray(colour, dtype=np.float32)),
        }
    return ground


def _painted_ground(colour: NDArray[np.float32]) -> dict[str, Any]:
    bitmap = mi.Bitmap(np.ascontiguousarray(colour))
    return {"type": "diffuse", "reflectance": {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat"}}
