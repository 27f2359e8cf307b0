"""Values at hits between the corners of their triangles, and between the texels of their textures."""

from __future__ import annotations

from typing import Any

from forestgen.render.identity.tracer import NONE, Hits, SceneTracer
from forestgen.render.variant import dr, mi

Places = list[tuple[Any, Any]]  # weights, Float, and rows of a table, UInt32


def corners_of(tracer: SceneTracer, hits: Hits) -> Places:
    """The triangle's three vertices, counted within the organ's mesh, with their barycentric weights."""
    weights = 1.0 - hits.uv.x - hits.uv.y, hits.uv.x, hits.uv.y
    rows = (dr.gather(mi.UInt32, tracer.table.corner, hits.face * 3 + k, hits.valid) for k in range(3))
    return list(zip(weights, rows, strict=True))


def weighted_sum(kind: Any, table: Any, places: Places, active: Any) -> Any:
    """Rows of a table of a kind of values, each times its weight."""
    total = kind(0.0)
    for weight, row in places:
        total += weight * dr.gather(kind, table, row, active)
    return total


def shading_normal(tracer: SceneTracer, hits: Hits, corners: Places, normal: Any) -> Any:
    """Vertex normals interpolated, on the side of the geometric `normal`; that one where the mesh has none."""
    first = dr.gather(mi.UInt32, tracer.table.first_normal, hits.organ, hits.valid)
    smooth = hits.valid & (first != NONE)
    rows = [(weight, first + corner) for weight, corner in corners]
    local = weighted_sum(mi.Vector3f, tracer.table.vertex_normal, rows, smooth)
    smooth &= dr.squared_norm(local) > 1e-12
    world = tracer.to_world(local, hits)
    world = dr.select(dr.dot(world, normal) < 0, -world, world)
    return dr.select(smooth, world, normal)


def vertex_uv(tracer: SceneTracer, hits: Hits, corners: Places, textured: Any) -> tuple[Any, Any]:
    """u and v of hits on textured meshes."""
    first = dr.gather(mi.UInt32, tracer.table.first_uv, hits.organ, textured)
    u, v = (
        weighted_sum(mi.Float, tracer.table.uv, [(w, (first + c) * 2 + axis) for w, c in corners], textured)
        for axis in range(2)
    )
    return u, v


def bilinear(texel: Any, first: Any, width: Any, height: Any, u: Any, v: Any, active: Any) -> Any:
    """Colours of repeating textures as in Mitsuba's `bitmap`: texel centres at (i + 0.5) / width, row 0 at v = 0."""
    return weighted_sum(mi.Color3f, texel, bilinear_places(first, width, height, u, v), active)


def bilinear_places(first: Any, width: Any, height: Any, u: Any, v: Any) -> Places:
    """Weights and rows of the four texels around a place of a repeating texture."""
    x, y = ((t - dr.floor(t)) * mi.Float(size) - 0.5 for t, size in ((u, width), (v, height)))
    left, low = mi.Int32(dr.floor(x)), mi.Int32(dr.floor(y))
    columns, rows = mi.Int32(width), mi.Int32(height)
    places = []
    for i, across in ((0, 1.0 - (x - dr.floor(x))), (1, x - dr.floor(x))):
        for j, up in ((0, 1.0 - (y - dr.floor(y))), (1, y - dr.floor(y))):
            column, row = _wrapped(left + i, columns), _wrapped(low + j, rows)
            places.append((across * up, first + mi.UInt32(row * columns + column)))
    return places


def _wrapped(index: Any, size: Any) -> Any:
    """Index of -1 to `size`, into a row that repeats."""
    return dr.select(index < 0, index + size, dr.select(index >= size, index - size, index))
