"""BSDFs of plants and ground, and how they change when a pass is for other wavelengths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.plants.bark.texture import SurfaceTexture
from forestgen.render.gloss import gloss_of
from forestgen.render.variant import mitsuba
from forestgen.scene.channels import RGB, Channels
from forestgen.scene.soil_colour import film_factor
from forestgen.scene.spec import Material, Terrain

LEAFLIKE = (Part.LEAF, Part.FLOWER)
Recipe = Callable[[Channels], dict[str, Any]]


@dataclass
class Paints:
    """The BSDFs of a scene: built once, shared by its meshes, and given other colours between passes."""

    channels: Channels = RGB
    _painted: list[tuple[Any, Recipe]] = field(default_factory=list)
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
        """A BSDF that is made, and later repainted, by a function of the channels to a dictionary."""
        # Unoptimised: lobes that happen to be equal in one pass must not become one object for all.
        bsdf = mitsuba().load_dict(recipe(self.channels), optimize=False)
        self._painted.append((bsdf, recipe))
        return bsdf

    def repaint(self, channels: Channels) -> None:
        """Give all BSDFs the values of other channels, in place: scenes that hold them need no new building."""
        mi = mitsuba()
        for bsdf, recipe in self._painted:
            repaint(bsdf, mi.load_dict(recipe(channels), optimize=False))
        self.channels = channels


def repaint(old: Any, new: Any) -> None:
    """Copy the parameters of one Mitsuba object to another that was made alike."""
    mi = mitsuba()
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


def leaf_bsdf(material: Material, channels: Channels = RGB) -> dict[str, Any]:
    """A thin two-sided leaf: a matt and a glossy reflector, and a matt transmitter; both sides alike.

    R and T are the material's for light from 8 degrees and from the whole hemisphere; without gloss, and T always, for
    light from any direction. tests/system/test_leaf.py integrates them. `principledthin` with diff_trans 2 lets its
    colour through, evenly in all directions, and reflects nothing.

    Each lobe is chosen as often as its share of the light, and carries the light over that share. So its colour
    may pass 1, and nothing is clipped or lost, whichever channels are large.
    """
    if not has_transmittance(material):
        return reflector(material, channels)
    sides = sides_of(material, channels)
    share = sides.shares[0]
    return {
        "type": "blendbsdf",
        "weight": share,
        "r": reflector(material, channels, 1.0 - share),
        "t": {"type": "principledthin", "base_color": _unbounded(sides.through, share), "diff_trans": 2.0},
    }


def reflector(material: Material, channels: Channels = RGB, share: float = 1.0) -> dict[str, Any]:
    """What a surface reflects, on both sides, over a share of the paths."""
    sides = sides_of(material, channels)
    if not gloss_share(material):
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _unbounded(sides.matt, share)}}
    glossy, gloss = sides.shares[1], gloss_of(material.roughness)
    return {
        "type": "twosided",
        "bsdf": {
            "type": "blendbsdf",
            "weight": glossy,
            "d": {"type": "diffuse", "reflectance": _unbounded(sides.matt, share * (1.0 - glossy))},
            "g": {
                "type": "roughconductor",
                "distribution": "ggx",
                "alpha": gloss.alpha,
                "eta": gloss.index,
                "k": 0.0,
                "specular_reflectance": _unbounded(np.full(3, sides.gloss / gloss.albedo), share * glossy),
            },
        },
    }


def has_transmittance(material: Material) -> bool:
    """Whether light passes a leaf of the material, in any channels."""
    spectrum = material.transmittance_spectrum
    return max(material.transmittance) > 0 or (spectrum is not None and float(spectrum.value.max()) > 0)


def _unbounded(colour: NDArray[np.float64], share: float) -> dict[str, Any]:
    """A lobe's colour over its share of the paths: a reflectance that may pass 1."""
    return {"type": "srgb", "color": (colour / max(share, 1e-9)).tolist(), "unbounded": True}


def surface_bsdf(part: Part, material: Material, channels: Channels = RGB, *, has_uv: bool = False) -> dict[str, Any]:
    """BSDF of a plant's surface; a texture needs a mesh with uv. Wood lets no light through."""
    if part in LEAFLIKE:
        return leaf_bsdf(material, channels)
    if material.texture is not None and has_uv:
        return textured_bsdf(material, material.texture, channels)
    return reflector(replace(material, transmittance=(0.0, 0.0, 0.0), transmittance_spectrum=None), channels)


def diffuse(reflectance: NDArray[np.float64]) -> dict[str, Any]:
    """A Lambertian surface of one colour, (3,)."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(x) for x in reflectance]}}


def textured_bsdf(material: Material, texture: SurfaceTexture, channels: Channels) -> dict[str, Any]:
    """Diffuse surface with a colour and a normal map.

    Under a sky that is equally bright everywhere, a facet that leans from the surface by an angle a gets only
    (1 + cos a) / 2 of what the surface gets: the rest of its hemisphere lies below the surface. What it misses there
    would come from the facet opposite. The colour is divided by that share, so that the mean reflectance stays the
    texture's own. The renderer's shading of the terminator would take some more, and stays off.
    """
    normals = texture.normals()
    seen = 0.5 + 0.5 * normals[..., 2:]
    spectrum = material.reflectance_spectrum
    colour = channels.texture(texture.colour, material.reflectance, spectrum, seen[..., 0]) / seen
    return {
        "type": "twosided",
        "bsdf": {
            "type": "normalmap",
            "use_shadowing_function": False,
            "normalmap": _bitmap(0.5 + 0.5 * normals),
            "bsdf": {"type": "diffuse", "reflectance": _bitmap(colour)},
        },
    }


def _bitmap(image: NDArray[Any]) -> dict[str, Any]:
    """A texture of linear values, row 0 at v = 0, that repeats."""
    bitmap = mitsuba().Bitmap(np.ascontiguousarray(image, dtype=np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat", "format": "fp16"}


def ground_bsdf(terrain: Terrain, channels: Channels = RGB) -> dict[str, Any]:
    """Diffuse ground: the terrain's texture on the site, darker where it is wet, one colour in the distance."""
    colour = np.maximum(channels.texture(terrain.texture, terrain.mean_colour, terrain.spectrum), 0.0)
    near = _painted_ground(colour)
    if terrain.wet is not None:
        near = {
            "type": "blendbsdf",
            "weight": {"type": "mesh_attribute", "name": "vertex_wet_share"},
            "dry": near,
            "wet": _painted_ground(colour * film_factor(terrain, channels).astype(np.float32)),
        }
    return {
        "type": "twosided",
        "bsdf": {
            "type": "blendbsdf",
            "weight": {"type": "mesh_attribute", "name": "vertex_far_share"},
            "near": near,
            "far": diffuse(channels.of_surface(terrain.far_reflectance, terrain.far_spectrum)),
        },
    }


def _painted_ground(colour: NDArray[np.float32]) -> dict[str, Any]:
    bitmap = mitsuba().Bitmap(np.ascontiguousarray(colour))
    return {
        "type": "diffuse",
        "reflectance": {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat"},
    }
