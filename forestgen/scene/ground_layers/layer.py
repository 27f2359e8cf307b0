"""What a layer of the ground cover is: things that lie or grow on the ground, by the tile."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Floats, Mesh, triangle_areas
from forestgen.geometry.patches import Patch, to_mesh
from forestgen.plants.exemplar import OrganMesh
from forestgen.recipe.ground import GroundLayer
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.sources import Keys
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.spec import Material

GROUND = "(ground)"  # species of the tiles: no species' name has brackets
KeysT = TypeVar("KeysT", bound=GroundLayer)
Places = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class Thing:
    """One thing in its own frame: on the ground z = 0, its middle in the origin, metres."""

    organs: tuple[OrganMesh, ...]
    length_m: float
    closed: bool = False  # its meshes are surfaces of bodies, not sheets
    is_bushy: bool = False  # its sheets lie above one another
    rise: float = 1.0  # how far it leans and lies up, share of its layer's tilt and depth

    @property
    def hidden_m2(self) -> float:
        """Ground that it hides, seen from above; of a bush, as if its sheets were at random over its ellipse."""
        shadow, box = 0.0, np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
        for organ in self.organs:
            flat = organ.mesh.vertices_m * np.array([1.0, 1.0, 0.0], dtype=np.float32)
            shadow += float(triangle_areas(flat, organ.mesh.faces).sum()) * (0.5 if self.closed else 1.0)
            box = np.stack([np.minimum(box[0], flat[:, :2].min(0)), np.maximum(box[1], flat[:, :2].max(0))])
        round_m2 = max(0.25 * np.pi * float(np.prod(box[1] - box[0])), 1e-9)
        return round_m2 * (1.0 - float(np.exp(-shadow / round_m2))) if self.is_bushy else shadow


@dataclass(frozen=True)
class Spread:
    """How the things of a layer lie."""

    tilt_deg: float = 0.0  # standard deviation of their lean
    depth_m: float = 0.0  # of the layer: how far they lie on each other
    size_sigma: float = 0.0  # of the logarithm of their size
    sunk: float = 0.0  # share of their height that is in the ground


@dataclass(frozen=True)
class Layer:
    """Things of one kind, and where they lie."""

    name: str  # unique in the recipe's ground
    things: tuple[Thing, ...]  # each as frequent as the others
    materials: Mapping[str, Material]  # of their meshes, by name
    cover: float  # share of the ground that it hides, mean
    leaf: Material  # its things' mean surface
    trapped: float  # share of the light that leaves a thing and meets another one, p
    spread: Spread = Spread()
    patch_m: float | None = None
    relative: Floats | None = None  # factor on the cover, by square metre of the ground's texture; None: even
    where: Places | None = None  # relative density by x, y of the site, of mean 1; None: the same everywhere
    heaped_m: float = 0.0  # how high its things lie against stems; 0: no higher than elsewhere
    floats: bool = False  # on water
    is_painted: bool = True  # whether the ground has its mean colour where it is not geometry

    @property
    def spectrum(self) -> Spectrum:
        """What the layer reflects as a whole, seen from above: R (1 - p) / (1 - p w) of things of reflectance R, which
        with their transmittance is w (photon recollision: Smolander and Stenberg 2005, Remote Sensing of Environment
        94, 355-363).
        """
        reflected, passed = self.leaf.reflectance_spectrum, self.leaf.transmittance_spectrum
        assert reflected is not None  # of all layers
        albedo = reflected.value + (0.0 if passed is None else passed.at(reflected.wavelength_nm))
        kept = (1.0 - self.trapped) / (1.0 - self.trapped * albedo)
        return Spectrum(reflected.wavelength_nm, reflected.value * kept)


@dataclass(frozen=True)
class Request:
    """What layers are made for."""

    drawn: DrawnRecipe
    generators: Mapping[str, Any]  # parameters of the species' plants
    leaf_share: Mapping[str, tuple[float, Places]]  # by species: its share of the stand's leaf area, and where it is
    pixel_m: float  # what a pixel covers of the ground where it is seen best
    where: tuple[str | int, ...]  # of the layer in the recipe

    def detail(self, length_m: float) -> int:
        """0, 1 or 2: how finely a thing is drawn."""
        across = length_m / max(self.pixel_m, 1e-9)
        return 0 if across < 10.0 else 1 if across < 40.0 else 2


class GroundLayerKind(Generic[KeysT]):
    """A kind of layer."""

    Parameters: type[KeysT]
    most_triangles: int = 400_000  # of its tiles, about: for the estimate of memory

    def check(self, keys: KeysT, drawn: DrawnRecipe, where: Keys) -> None:
        """Raise `RecipeError` for keys that do not fit the recipe; `where`: of the layer."""

    def layers(self, keys: KeysT, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        """What lies there; several where the kind of thing changes from place to place.

        Raises `RecipeError`: things that cannot be made.
        """
        raise NotImplementedError


def sheet(part: Part, material: str, *patches: Patch) -> OrganMesh:
    """Patches of an organ's frame as a mesh of a part and material."""
    return OrganMesh(part, material, to_mesh(*patches))


def centred(organs: Sequence[OrganMesh]) -> tuple[OrganMesh, ...]:
    """The same with the middle of their box in the origin, the lowest point at z = 0."""
    points = np.concatenate([one.mesh.vertices_m for one in organs])
    low, high = points.min(axis=0), points.max(axis=0)
    shift = np.array([*(0.5 * (low + high)[:2]), low[2]], dtype=np.float32)
    return tuple(OrganMesh(one.part, one.material, moved(one.mesh, shift)) for one in organs)


def moved(mesh: Mesh, shift_m: NDArray[np.float32]) -> Mesh:
    """The mesh less a shift."""
    return Mesh(mesh.vertices_m - shift_m, mesh.faces, mesh.normals, mesh.uv)


def scaled(material: Material, factor: float) -> Material:
    """The material darker or brighter, without texture."""
    reflected, passed = (
        None if one is None else Spectrum(one.wavelength_nm, np.minimum(factor * one.value, 0.9))
        for one in (material.reflectance_spectrum, material.transmittance_spectrum)
    )
    (r, g, b), (u, v, w) = (
        np.minimum(factor * np.array(one), 0.9) for one in (material.reflectance, material.transmittance)
    )
    colours = (float(r), float(g), float(b)), (float(u), float(v), float(w))
    return Material(*colours, material.roughness, None, material.gloss, reflected, passed)


def shades(material: Material, factors: Sequence[float], name: str) -> dict[str, Material]:
    """The material darker and brighter: by name-0, name-1, ..."""
    return {f"{name}-{index}": scaled(material, factor) for index, factor in enumerate(factors)}


def mean_surface(materials: Sequence[Material], share: Floats | None = None) -> Material:
    """A surface with the mean spectra of several, all of which have one; `share`: (M,) of each, even if not given."""

    def mean(spectra: Sequence[Spectrum | None]) -> Spectrum | None:
        known = [one for one in spectra if one is not None]
        if len(known) < len(spectra):
            return None
        grid = np.unique(np.concatenate([one.wavelength_nm for one in known]))
        return Spectrum(grid, np.average([one.at(grid) for one in known], axis=0, weights=share))

    reflected = mean([one.reflectance_spectrum for one in materials])
    assert reflected is not None  # of all layers
    passed = mean([one.transmittance_spectrum for one in materials])
    first = materials[0]
    colours = colours_of_surface(reflected, passed)
    return Material(*colours, first.roughness, None, first.gloss, reflected, passed)


def opaque(spectrum: Spectrum, roughness: float = 0.8) -> Material:
    """A surface of a reflectance."""
    return Material(colours_of_surface(spectrum, None)[0], roughness=roughness, reflectance_spectrum=spectrum)
