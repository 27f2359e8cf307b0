"""The gloss of a leaf's skin: a lobe that reflects the same share of the light from nearly every angle.

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

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SPHERE_DEG = 8.0  # from which an integrating sphere is lit
LEAST_ROUGHNESS, MOST_ROUGHNESS = 0.2, 0.7  # below, highlights are specks of noise; above, no index fits
_GRID = 64  # points along each side of the square that is mapped to visible facets
_RINGS = 12  # of the hemisphere


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
        return float(sum(w / 2 * _albedo(ring, index) for w, ring in zip(weight, rings, strict=True))) - _albedo(
            sphere, index
        )

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
