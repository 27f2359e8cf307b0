"""Light at surfaces of water (scene/water.py) and in it.

A path that meets a surface is mirrored or goes through, by chance as Fresnel's equations for unpolarised light share
it, of an index of 1.333, above and below. What goes through is refracted (Snell). The surface's normal is that of its
waves; light that is mirrored from above leaves about a facet as well, of those too small for waves (GGX, Heitz 2018).
Radiance that enters water grows by the index squared, as its cone narrows. On its way in water light is absorbed (Beer
and Lambert), and not scattered. So a bed without absorption under water without absorption is as bright under an even
sky as without water.

The sun would be met through water by few paths. So light of its disc is looked for from the bed as if the surface above
were level: it comes along the refracted direction, less by Fresnel and by absorption. Waves' light patterns on the bed,
and no light, are lost: their mean is that of the level surface. Sky and trees are seen through the waves.

What sun a surface mirrors to a trunk would be met by few paths, too, each very bright. So a path that met something
matt before has facets that lean by at least `_BLUNT` (Kaplanyan and Dachsbacher 2013): the light is blurred. Between
facets light that would go on below the surface is mirrored up.

References
----------
Heitz, E. (2018): Sampling the GGX distribution of visible normals. JCGT 7(4).
Kaplanyan, A., Dachsbacher, C. (2013): Path space regularization for holistic and robust light transport. Computer
Graphics Forum 32, 63-72.
"""

from __future__ import annotations

from typing import Any

from forestgen.core.parts import Part
from forestgen.render.identity.tracer import SceneTracer
from forestgen.render.paths.scattering import WATER_INDEX, Local, Surfaces, facet_density, fresnel, visible_facet
from forestgen.render.variant import dr, mi
from forestgen.scene.projection import DeviceRays

_BLUNT = 0.3  # width of the facets
_CERTAIN = 1e10  # density of a direction that no other way finds


class Shore:
    """Where paths meet surfaces, some of them of water; for others it is used as the surface."""

    def __init__(self, surface: Local, is_water: Any, organ: Any, body: Any, matt: Any) -> None:
        """By which surfaces are of water (Bool), and what is hit, as `Hits.organ`; and what `Paths` hold of water."""
        self._surface, self.geometric, self._organ = surface, surface.geometric, organ
        self._body, self._matt, self._passes = body, matt, mi.Bool(False)
        from_above, dry = surface.geometric.z > 0, body == 0
        self.from_above = is_water & from_above & dry
        self.from_below = is_water & ~from_above & ~dry
        self.unnoticed = is_water & ~self.from_above & ~self.from_below  # where two bodies overlap
        self.is_water = is_water
        self._width = dr.select(matt, dr.maximum(surface.gloss.y, _BLUNT), surface.gloss.y)

    def value(self, direction: Any) -> Any:
        """Color3f: see `Local.value`."""
        mirrored = self._mirrored(direction)
        return dr.select(self.is_water, mi.Color3f(mirrored), self._surface.value(direction))

    def density(self, direction: Any) -> Any:
        """Float: see `Local.density`."""
        own = dr.select(self.from_above & (direction.z > 0), self._mirrored(direction), _CERTAIN)
        return dr.select(self.is_water, own, self._surface.density(direction))

    def _mirrored(self, direction: Any) -> Any:
        """Float: what is mirrored from above, over the irradiance on a plane that faces it; and its density."""
        surface = self._surface
        half = dr.normalize(surface.towards + direction)
        share = fresnel(dr.dot(half, direction), mi.Float(WATER_INDEX))
        found = share * facet_density(surface.facet, surface.towards, half, self._width)
        return dr.select(self.from_above & (direction.z > 0), found, 0.0)

    def sample(self, lobe: Any, first: Any, second: Any) -> tuple[Any, Any]:
        """See `Local.sample`."""
        dry_direction, dry_weight = self._surface.sample(lobe, first, second)
        surface = self._surface
        axes = mi.Frame3f(surface.facet)
        half = axes.to_world(visible_facet(axes.to_local(surface.towards), self._width, first, second))
        normal = dr.select(self.from_above, half, surface.facet)
        index = dr.select(self.from_above, mi.Float(WATER_INDEX), 1.0 / WATER_INDEX)  # of what is beyond
        cosine = dr.maximum(dr.dot(normal, surface.towards), 1e-6)
        square = 1.0 - (1.0 - cosine * cosine) / dr.square(index)  # of the refracted cosine; below 0: none gets out
        mirrors = lobe < interface(cosine, index)
        bent = -surface.towards / index + normal * (cosine / index - dr.safe_sqrt(square))
        mirrored = 2.0 * cosine * normal - surface.towards
        side = dr.select(self.from_above, 1.0, -1.0)
        mirrored.z = side * dr.abs(mirrored.z)
        bent.z = -side * dr.maximum(dr.abs(bent.z), 1e-4)
        through = self.unnoticed | ~mirrors
        direction = dr.select(self.unnoticed, -surface.towards, dr.normalize(dr.select(mirrors, mirrored, bent)))
        weight = dr.select(self.unnoticed | mirrors, mi.Float(1.0), dr.rcp(dr.square(index)))
        self._passes = self.is_water & through & ~self.unnoticed
        direction = dr.select(self.is_water, direction, dry_direction)
        return direction, dr.select(self.is_water, mi.Color3f(weight), dry_weight)

    def after(self, in_fog: Any) -> dict[str, Any]:
        """What `Paths` hold of water after `sample`, but for those that scattered in fog before."""
        entered = dr.select(self.from_above, self._organ, 0)
        body = dr.select(self._passes & ~in_fog, entered, self._body)
        return {"water": body, "matt": self._matt | ~self.is_water | in_fog}


def interface(cosine: Any, index: Any) -> Any:
    """Float: reflectance for unpolarised light by the index beyond over that on this side; 1: none gets through."""
    square = 1.0 - (1.0 - cosine * cosine) / dr.square(index)
    inner = dr.safe_sqrt(square)
    across = (cosine - index * inner) / (cosine + index * inner)
    along = (index * cosine - inner) / (index * cosine + inner)
    return dr.select(square <= 0.0, 1.0, 0.5 * (across * across + along * along))


def refracted_down(direction: Any) -> Any:
    """Vector3f: the direction in water, under a level surface, towards a light in the air."""
    x, y = direction.x / WATER_INDEX, direction.y / WATER_INDEX
    return mi.Vector3f(x, y, dr.safe_sqrt(1.0 - x * x - y * y))


def entering(direction: Any) -> Any:
    """Float: irradiance in water on a plane that faces the light over that in the air, under a level surface."""
    inside = refracted_down(direction)
    up = dr.maximum(direction.z, 0.0)
    return (1.0 - interface(dr.maximum(up, 1e-6), mi.Float(WATER_INDEX))) * up / dr.maximum(inside.z, 1e-6)


def is_water(tracer: SceneTracer, organ: Any, valid: Any) -> Any:
    """Bool: whether organs that are hit are surfaces of water."""
    return valid & (dr.gather(mi.UInt32, tracer.table.part, organ, valid) == int(Part.WATER))


def out_of_water(
    tracer: SceneTracer, surfaces: Surfaces, ray: Any, light: Any, body: Any, active: Any
) -> tuple[Any, Any, Any]:
    """Where rays in water (Ray3f) meet its surface from below: whether they do, the place, and the share (Color3f) of
    the irradiance that comes down to where they began, of a light in a direction in the air.
    """
    hit = tracer.scene.ray_intersect_preliminary(ray, coherent=False, active=active)
    hits = tracer.looked_up(DeviceRays(ray.d, mi.Float(1.0)), hit, active)
    distance_m = dr.select(hits.valid, hits.distance_m, 0.0)
    share = dr.exp(-surfaces.absorption(body) * distance_m) * entering(light)
    return is_water(tracer, hits.organ, hits.valid), ray.o + ray.d * distance_m, share
