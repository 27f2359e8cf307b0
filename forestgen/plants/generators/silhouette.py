"""Silhouette plants: Lane's L-system 6.1 with branch mapping.

Reference
---------
Lane, B. (2002). Models of plant communities for image synthesis. MSc thesis, University of Calgary, chapter 6,
L-system 6.1; after Prusinkiewicz, P., Mündermann, L., Karwowski, R., Lane, B. (2001). The use of positional
information in the modeling of plants. SIGGRAPH 2001, 289-300.

Equations
---------
::

    Axiom: A(0, 0)
    A(o, s) : o < MAX_ORDER and s < max_len[o] { rel = s / max_len[o] }
        -> #(int_width(o, rel)) F(int_len(o, rel))
           [ +(branch_ang(o, rel)) A(o+1, max_len[o+1] - branch_len(o, rel)) ]
           /(phyllo_ang[o]) A(o, s + int_len(o, rel))
    A(o, s) : s >= max_len[o] -> ~K

A(o, s) is a branch of order o and length max_len[o] - s, so that short branches are the tops of longer ones. Height
H = A_H r^c_H and width W = A_W r^c_W come from the caller.

Parameters: see below; MAX_ORDER is the number of `orders`. K stands for `shapes` and `foliage`.

Recipe
------
::

    plant:
      generator: silhouette
      silhouette: ovoid
      crown_base: [[1, 0.1], [20, 0.38]]           # position: height of the plant in metres
      wood: {material: bark, branch_material: twig}
      trunk: {diameter_ratio: 0.013}
      orders:
        - {longest_m: 24, internode_m: [[0, 0.3], [1, 0.08]], branch_angle_deg: [[0, 75], [1, 40]]}
        - {longest_m: 2.6, internode_m: 0.2, diameter_m: [[0, 0.05], [1, 0.003]]}
      shapes: {leaf: {form: simple, material: leaf, length_m: 0.07, width_m: 0.07}}
      foliage: [{shape: leaf, orders: [0, 1], spacing_m: 0.05, within_m: 0.4}]

Decisions
---------
- max_len[0] in rel is the species' tallest stem, not this plant's height: branch mapping holds for the stem too, so
  a sapling is the top of a tree and not its miniature. Only the silhouette is relative to the plant's own height.
- branch_len(0, rel) is the length at which a branch that leaves under branch_ang meets the silhouette.
- Real branches bend: `upturn_deg_per_m` turns an axis to the sky (or the ground) as a torque, `wander_deg` bends it
  at random with memory. `fit` then stretches the plant, height and width apart, to H and W.
- The tip carries organs by rules of spacing (`Foliage`) rather than one K, since K grows on several internodes.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, Field, TypeAdapter, WithJsonSchema

from forestgen.geometry.mesh import Floats
from forestgen.plants.branching import Assembly, Order, Shoots, grow, lateral_sites
from forestgen.plants.parameters import Fit, PlantParameters
from forestgen.plants.skeleton import Skeleton, check_budget
from forestgen.plants.tree_size import TreeSize
from forestgen.recipe import curves
from forestgen.recipe.curves import Curve, FallingCurve, PositiveCurve, StrictlyPositiveCurve, evaluate, evaluate_one
from forestgen.recipe.fields import Section

_STEM_BYTES = 100_000  # of a stem with its branches, at least

SilhouetteName = Literal["ellipsoid", "ovoid", "cone", "column"]
_NAMES = get_args(SilhouetteName)
_curve: TypeAdapter[Any] = TypeAdapter(PositiveCurve)
_FINE = np.linspace(0.0, 1.0, 1001)


def _read(value: Any) -> Any:
    if isinstance(value, str):
        if value not in _NAMES:
            raise ValueError(f"no silhouette is called {value!r:.40}; there are {', '.join(_NAMES)}, or draw a curve")
        return value
    curve = _curve.validate_python(value)
    if evaluate(curve, _FINE).max() <= 0.0:
        raise ValueError("a silhouette that is nowhere wider than 0 has no branches")
    return curve


#: Crown radius over the height within the crown (0 its base, 1 its top), scaled so that the greatest counts as 1.
Silhouette = Annotated[
    Any,
    BeforeValidator(_read),
    WithJsonSchema({"anyOf": [{"type": "string", "enum": list(_NAMES)}, *curves.CURVE_SCHEMA["anyOf"]]}),
]


def envelope(silhouette: SilhouetteName | curves.Function, height: Floats) -> Floats:
    """Crown radius as a share of the greatest, at a height within the crown, 0 its base and 1 its top; 0 outside."""
    u = np.clip(height, 0.0, 1.0)
    match silhouette:
        case "ellipsoid":
            form = np.sqrt(np.maximum(1.0 - (2.0 * u - 1.0) ** 2, 0.0))
        case "ovoid":  # an ellipsoid with its widest part at 38% and a blunter foot
            form = np.sqrt(np.maximum(1.0 - (2.0 * u**0.716 - 1.0) ** 2, 0.0)) ** 0.85
        case "cone":
            form = np.minimum(1.0, 0.7 + 3.0 * u) * (1.0 - u) ** 0.92 / 0.907
        case "column":
            form = np.minimum(1.0, np.minimum(0.6 + 4.0 * u, np.sqrt(np.maximum(1.0 - u, 0.0) * 5.0)))
        case drawn:
            form = evaluate(drawn, u) / evaluate(drawn, _FINE).max()
    return np.asarray(np.where((height < 0.0) | (height > 1.0), 0.0, form), dtype=np.float64)


def silhouette_length(
    silhouette: SilhouetteName | curves.Function, foot: Floats, angle_rad: Floats, crown_m: float, width_m: float
) -> Floats:
    """(M,) length of straight branches from the axis of the crown to its silhouette, metres.

    `foot`: (M,) height of the branch's foot within the crown, 0 its base and 1 its top. `angle_rad`: (M,) from the
    vertical. `crown_m`, `width_m`: height and width of the crown.
    """
    sine, cosine = np.maximum(np.sin(angle_rad), 0.15), np.cos(angle_rad)
    share = np.linspace(0.0, 1.0, 65)[1:]
    farthest = 0.5 * width_m / sine
    outward = share * (0.5 * width_m)
    height = foot[:, None] + share * (farthest * cosine / crown_m)[:, None]
    inside = outward <= 0.5 * width_m * envelope(silhouette, height)
    reached = np.where(np.all(inside, axis=1), len(share), np.argmin(inside, axis=1))
    return np.asarray(np.where(foot < 0.0, 0.0, farthest * (reached / len(share))), dtype=np.float64)


class Trunk(Section):
    """Stems: axes of order 0, from the ground up."""

    diameter_ratio: PositiveCurve = Field(((0.0, 0.014),), description="base diameter by height, over height in metres")
    taper: FallingCurve = Field(
        ((0.0, 1.0), (0.9, 0.18), (1.0, 0.02)), description="share of the base diameter over the stem, 0 base, 1 tip"
    )
    lean_deg: float = Field(1.5, ge=0, description="standard deviation of a single stem's lean at its foot, degrees")
    length_ratio: StrictlyPositiveCurve = Field(
        ((0.0, 1.0),), description="stem length over the plant's height, by that height; rosettes below 1, canes above"
    )
    stems: PositiveCurve = Field(((0.0, 1.0),), description="number of stems over the plant's height in metres")
    stem_spread_deg: float = Field(8.0, ge=0, description="lean of the further stems of a clump, degrees")


class Parameters(PlantParameters):
    """The `plant:` block of a species' file."""

    generator: Literal["silhouette"] = "silhouette"
    silhouette: Silhouette = Field(
        "ellipsoid",
        description="branch_len(0, .): form of the crown: ellipsoid, ovoid, cone, column, or a curve of its radius "
        "over the height within it, 0 its base and 1 its top, in any unit: the greatest is the plant's width",
    )
    crown_base: Curve = Field(((0.0, 0.3),), description="crown's lower end, share of height, over height in metres")
    trunk: Trunk = Field(description="int_width(0, .), and the stems")
    orders: tuple[Order, ...] = Field(min_length=1, max_length=8, description="the stem, its branches, and so on")
    fit: Fit = Field("stretch", description="as for every generator; height and width fit by default")


_Parameters = Parameters  # the generator's attribute hides the name


class SilhouetteGenerator:
    """Grows plants by L-system 6.1."""

    Parameters = Parameters  # the class that a recipe's `plant` block is checked against
    has_crown = True

    def grow(self, parameters: _Parameters, height_m: float, width_m: float, rng: np.random.Generator) -> Skeleton:
        """Stems and branches that fill the silhouette, before the fit."""
        trunk, orders = parameters.trunk, parameters.orders
        shoots = _stems(trunk, height_m, rng)
        grown = grow(shoots, orders[0], rng)
        base = 0.5 * height_m * evaluate_one(trunk.diameter_ratio, height_m) * (shoots.length_m / shoots.length_m[0])
        radius = base[grown.axis] * evaluate(trunk.taper, 1.0 - grown.remaining_m / shoots.length_m[grown.axis])
        root = Skeleton.of([-1], np.zeros((1, 3)), base[:1], np.zeros(1), np.zeros(1))
        assembly = Assembly(root, axes=0)
        index = assembly.add(0, grown, shoots, radius)
        for order in range(1, len(orders)):
            rules = orders[order - 1]
            sites = lateral_sites(grown, rules, rng)
            if order == 1:
                stem = grown.axis[sites.node]
                rise = 1.0 - grown.remaining_m[sites.node] / shoots.length_m[stem]
                low = evaluate_one(parameters.crown_base, height_m)
                crown = (rise - low) / (1.0 - low), sites.angle_rad, (1.0 - low) * height_m, width_m
                full = silhouette_length(parameters.silhouette, *crown)
            else:
                full = np.full(len(sites.node), orders[order].longest_m)
            jitter = np.clip(1.0 + rules.branch_length_jitter * rng.normal(size=len(full)), 0.3, 1.4)
            between = np.where(sites.in_whorl, 1.0, rules.between_length * rng.uniform(0.6, 1.0, len(full)))
            length = full * evaluate(rules.branch_length, grown.relative[sites.node]) * jitter * between
            chosen = (length >= rules.shortest_m) & (rng.random(len(length)) >= rules.missing)
            node = sites.node[chosen]
            shoots = Shoots(grown.position_m[node], sites.direction[chosen], length[chosen], index[node])
            grown = grow(shoots, orders[order], rng)
            index = assembly.add_branches(order, grown, shoots, orders[order])
        return assembly.skeleton()

    def shaped(self, parameters: _Parameters, size: TreeSize) -> _Parameters:
        """See `plants.parameters.ShapesTrees`."""
        return parameters.model_copy(update={"crown_base": ((0.0, size.crown_base_m / size.height_m),)})

    def crown_profile(self, parameters: _Parameters, height_m: float, width_m: float) -> tuple[Floats, Floats]:
        """(K,) heights and (K,) radii of the silhouette, metres, from the crown's base to its top."""
        base = evaluate_one(parameters.crown_base, height_m)
        share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 49))  # closer where an ellipsoid closes
        return height_m * (base + (1.0 - base) * share), 0.5 * width_m * envelope(parameters.silhouette, share)


def _stems(trunk: Trunk, height_m: float, rng: np.random.Generator) -> Shoots:
    wanted = evaluate_one(trunk.stems, height_m)
    check_budget("stems", wanted, _STEM_BYTES, "fewer trunk.stems")
    count = max(1, round(wanted))
    azimuth = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * (np.arange(count) + 0.25 * rng.normal(size=count)) / count
    lean = np.radians(np.abs(trunk.lean_deg * rng.normal(size=count)))
    lean[1:] += np.radians(trunk.stem_spread_deg) * rng.uniform(0.6, 1.3, count - 1)
    direction = np.stack([np.sin(lean) * np.cos(azimuth), np.sin(lean) * np.sin(azimuth), np.cos(lean)], axis=1)
    length = height_m * evaluate_one(trunk.length_ratio, height_m) * np.ones(count)
    length[1:] *= rng.uniform(0.7, 0.95, count - 1)
    return Shoots(np.zeros((count, 3)), direction, length, np.zeros(count, np.int64))


GENERATOR = SilhouetteGenerator()
