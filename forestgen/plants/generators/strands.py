"""Strand trees: branches are bundles of strands that divide until each holds one.

Reference
---------
Zamuda, A., Brest, J., Guid, N., Žumer, V. (2007). Construction of virtual trees within ecosystems with EcoMod tool.
Algorithm 1 and Eqs. 1-6. After Holton, M. (1994). Strands, gravity, and botanical tree imagery. Computer Graphics
Forum 13(1), 57-67.

Equations
---------
::

    branchsegment(g, w, S_0, L_0, l_0):
        d = k_d sqrt(S_0);  S_0 = 1: leaves, and no more
        S_1 = ceil(1 + k_s (S_0 - 2));           S_2 = S_0 - S_1
        r_i = max(min(sqrt(S_i / S_0), M), m);   L_i = r_i L_0;      l_i = k_l L_i
        alpha_1 = k_c sqrt(S_2 / S_0) alpha;     alpha_2 = alpha - alpha_1
        alpha_x(t) = sin(t + R_x) w_s (1 - k_f) l_0,  alpha_z(t) likewise;   alpha_w: see below
        M_i = M_0 T_y(l_0) R_w0(alpha_w) R_{y x y_m}(alpha_m) R_y(alpha_p) R_x(alpha_x) R_z(+-alpha_i + alpha_z)
        branchsegment(g, w + 1, S_1, L_1, l_1)        major: continues the axis
        branchsegment(g + 1, w + 1, S_2, L_2, l_2)    minor: a new axis

    k_s = max(min(k_s^g k_s^w, 1), 1/2)      (1)      M   = M^g M^w        (4)
    alpha = min(alpha^g alpha^w, 180)        (2)      k_l = k_l^g k_l^w    (5)
    alpha_m = +-180 at most, alpha_m^g alpha_m^w (3)  m   = m^g m^w        (6)

g is the Gravelius order (0 the trunk, one more at each minor sub-branch), w the Weibull order (segments from the foot).

Parameters: see below. The six local parameters have two curves each, `gravelius` over g and `weibull` over w,
evaluated at whole numbers.

Recipe
------
::

    plant:
      generator: strands
      fit: none
      strands: 1000
      trunk_length_m: 5
      split: {gravelius: [[0, 0.75], [15, 0.9]]}
      shortest: {gravelius: [[0, 1], [7.5, 0.45], [15, 1]]}
      wood: {material: bark}
      shapes: {leaf: {form: simple, material: leaf, length_m: 0.1, width_m: 0.07}}
      leaves: {shape: leaf, arrangement: spiral, density: 5, size_m: 0.2862}

Decisions
---------
- The paper's text refers to Eqs. 3, 4, 5 and 6 for m, M, k_l and alpha_m; the equations themselves and their ranges
  count: alpha_m, M, k_l and m.
- L_0 starts at 1 and l_0 is a length of its own: a trunk's base of 5 m, segments of about 1 m above it. So the paper's
  beech stands 27 m high and its pine 23 m.
- Algorithm 1 turns both sub-branches by a positive angle about z. alpha is the angle between them (section II.B), so
  the minor one turns by -alpha_2 here.
- Matrices are printed for row vectors; here they multiply columns, in the same frames. The inverse matrices, whose
  printed order fits neither, are the inverses.
- The paper does not say where y_m points. Here it is down, so a positive alpha_m droops; the pine's negative ones raise
  its branches' tips. A turn ends where down (or up) is reached, counted without directed wind, as printed.
- With k_c = 0.98 as printed the pine's trunk turns by 27 degrees at every division, a screw that leans by 19 degrees;
  its name and Figure 4 ask for a straight one. So alpha_1 = (1 - k_c) ... is offered as `gravicentralism_as: upright`,
  which the recipe of Figure 4 uses with the printed 0.98.
- The wind's turn is about w in the plant frame: the printed place of R_w0 would turn it about an axis that is known in
  the bearer's frame only. Angles of the wind are in degrees, since sliders end at 10.
- alpha_w = S_0/S w_g, as printed, bends a trunk most. Drag on a branch grows with its leaves, S_0, its stiffness with
  d^4, S_0^2: (1 - S_0/S) w_g is the default (`bends`). The paper's w = [0 1 0] is the trunk's own direction: [0, 0, 1]
  here, which turns without bending.
- The pine has 6000 strands where the slider ends at 5000: the bound here is 200,000. rho_l is the number of leaves on
  a branch of one strand: 5000 leaves on the paper's beech.
- l_LOD is 0 in both models and not explained. Here a branch of at most `lod` strands is one segment, with the leaves
  of one strand, larger by the root of its strands.
- The curve of the pine's k_s^w has two points at 42.89; positions must ascend, so write 42.89 and 42.8901.
- By the square root, 2000 strands that make a trunk of half a metre make a twig of a centimetre. A larger
  `thickness_exponent` gives thinner twigs; sections then shrink from bearer to sub-branches.
- A young tree is no miniature: `strands` and `scale_by_height` say how many branches it has and how large they are.
- Jitters are not in the paper. Phases in the wind and the form come from separate random streams.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from forestgen.core.errors import RecipeError
from forestgen.geometry.mesh import Floats
from forestgen.plants.build import fit, moved
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.skeleton import OrganPlacements, Skeleton, check_budget
from forestgen.plants.strands import JITTERS, ORDERS, Branching, Leaves, Pose, Wind, carried, divide, leaf_places, pose
from forestgen.plants.tree_fit import fit_tree
from forestgen.plants.tree_size import TreeSize
from forestgen.recipe.curves import Curve, Formula, PositiveCurve, Smooth, evaluate, evaluate_one
from forestgen.recipe.fields import Section

MOST_STRANDS = 200_000
# Where a species' file says nothing of wind, or makes the plant too stiff to move; degrees.
_BREEZE, _GIVING = {"speed_directed": 1.0, "speed_undirected": 2.5}, 0.3
_SEGMENT_BYTES = 1200  # a segment's place in all arrays of its making, its node, and its share of a tube


def _within(low: float, high: float) -> AfterValidator:
    """Values of a curve must lie in a range; a formula's are cut to it when they are evaluated."""

    def check(curve: Any) -> Any:
        if not isinstance(curve, Formula):
            points = curve.points if isinstance(curve, Smooth) else curve
            wrong = [value for _, value in points if not low <= value <= high]
            if wrong:
                raise ValueError(f"the values of this curve must lie between {low:g} and {high:g}, got {wrong[0]:g}")
        return curve

    return AfterValidator(check)


_OverDepth = Annotated[Curve, _within(0.0, 2.0)]


class _Local(Section):
    """A local parameter: the product of two curves."""

    weibull: _OverDepth = Field(default=((0.0, 1.0),), description="factor over the Weibull order w, 0 to 2")


class Split(_Local):
    """k_s: the share of strands that the major sub-branch keeps."""

    gravelius: Annotated[Curve, _within(0.5, 1.0)] = Field(default=((0.0, 0.75),), description="over g, 1/2 to 1")


class Angle(_Local):
    """alpha: the angle between the two sub-branches."""

    gravelius: Annotated[Curve, _within(0.0, 180.0)] = Field(
        default=((0.0, 45.0),), description="over g, 0 to 180 degrees"
    )


class Shortest(_Local):
    """m: least ratio of a sub-branch's length to its bearer's."""

    gravelius: Annotated[Curve, _within(0.0, 10.0)] = Field(default=((0.0, 0.0),), description="over g, 0 to 10")


class Longest(_Local):
    """M: greatest ratio of a sub-branch's length to its bearer's."""

    gravelius: Annotated[Curve, _within(0.0, 10.0)] = Field(default=((0.0, 1.0),), description="over g, 0 to 10")


class Length(_Local):
    """k_l: a segment's length over its relative length."""

    gravelius: Annotated[Curve, _within(0.0, 10.0)] = Field(default=((0.0, 1.0),), description="over g, 0 to 10 metres")


class Gravimorphism(_Local):
    """alpha_m: turn to the ground (or, negative, to the sky) at a division."""

    gravelius: Annotated[Curve, _within(-180.0, 180.0)] = Field(
        default=((0.0, 0.0),), description="over g, within 180 degrees"
    )


class Parameters(PlantParameters):
    """The `plant:` block of a species' file."""

    generator: Literal["strands"] = "strands"
    strands: Annotated[PositiveCurve, _within(1.0, MOST_STRANDS)] = Field(
        ((0.0, 1000.0),), description="S: strands in all, by the plant's height in metres; 1 to 200,000"
    )
    trunk_length_m: Annotated[PositiveCurve, _within(0.0, 20.0)] = Field(
        ((0.0, 5.0),), description="l_0: length of the trunk's base segment, by the plant's height in metres"
    )
    scale_by_height: PositiveCurve = Field(((0.0, 1.0),), description="factor on the wood's size by height in metres")
    thickness_m: float = Field(0.01, gt=0, le=0.05, description="k_d: diameter of a branch of one strand, metres")
    thickness_exponent: float = Field(0.5, ge=0.3, le=1, description="diameter's power of strands; 0.5 keeps sections")
    gravicentralism: float = Field(0.3, ge=0, le=1, description="k_c, see `gravicentralism_as`")
    gravicentralism_as: Literal["printed", "upright"] = Field(
        "printed",
        description="printed: 0 is a straight trunk, 1 one that gives way to each minor sub-branch; upright: 1 - k_c "
        "in its place, so that 1 is straight, as the name and the paper's pine ask",
    )
    phyllotaxis_deg: float = Field(85.0, ge=0, le=360, description="alpha_p: turn of the plane of division, degrees")
    split: Split = Field(Split(), description="k_s: the share of strands that the major sub-branch keeps")
    angle_deg: Angle = Field(Angle(), description="alpha: the angle between the two sub-branches, degrees")
    shortest: Shortest = Field(Shortest(), description="m: least ratio of a sub-branch's length to its bearer's")
    longest: Longest = Field(Longest(), description="M: greatest ratio of a sub-branch's length to its bearer's")
    length: Length = Field(Length(), description="k_l: a segment's length over its relative length, metres")
    gravimorphism_deg: Gravimorphism = Field(Gravimorphism(), description="alpha_m: turn down at a division, degrees")
    lod: int = Field(0, ge=0, le=10_000, description="branches of so many strands or fewer are not divided further")
    stiffness: float = Field(1.0, ge=0, le=1, description="k_f: 1: no sway in the undirected wind")
    wind: Wind = Field(Wind(), description="the wind that the plant stands in")
    leaves: Leaves | None = Field(None, description="leaves of the branches that carry one strand")
    split_jitter: float = Field(0.0, ge=0, le=0.5, description="standard deviation of k_s")
    angle_jitter_deg: float = Field(
        0.0, ge=0, le=90, description="standard deviation of a sub-branch's angles, degrees; less for the heavier one"
    )
    phyllotaxis_jitter_deg: float = Field(0.0, ge=0, le=180, description="standard deviation of alpha_p, degrees")
    length_jitter: float = Field(0.0, ge=0, le=1, description="standard deviation of the logarithm of a length")

    @model_validator(mode="after")
    def _leaf_has_shape(self) -> Self:
        if self.leaves is not None and self.leaves.shape not in self.shapes:
            raise ValueError(f"leaves name the shape {self.leaves.shape!r}; there are: {', '.join(self.shapes)}")
        return self


_Parameters = Parameters  # the generator's attribute hides the name


def tables(parameters: Parameters) -> tuple[Floats, Floats]:
    """(6, ORDERS) auxiliary local parameters over g and over w, within their ranges; angles in radians."""
    p = parameters
    order = np.arange(ORDERS, dtype=np.float64)
    rows: list[tuple[_Local, Any, tuple[float, float], float]] = [
        (p.split, p.split.gravelius, (0.5, 1.0), 1.0),
        (p.angle_deg, p.angle_deg.gravelius, (0.0, 180.0), np.pi / 180.0),
        (p.shortest, p.shortest.gravelius, (0.0, 10.0), 1.0),
        (p.longest, p.longest.gravelius, (0.0, 10.0), 1.0),
        (p.length, p.length.gravelius, (0.0, 10.0), 1.0),
        (p.gravimorphism_deg, p.gravimorphism_deg.gravelius, (-180.0, 180.0), np.pi / 180.0),
    ]
    by_order = [np.clip(evaluate(curve, order), *bounds) * unit for _, curve, bounds, unit in rows]
    by_depth = [np.clip(evaluate(local.weibull, order), 0.0, 2.0) for local, _, _, _ in rows]
    return np.array(by_order), np.array(by_depth)


def branching_of(parameters: Parameters, height_m: float, rng: np.random.Generator) -> Branching:
    """Who divides into what. Raises `RecipeError`: the plant has no length, or too many segments for memory."""
    p = parameters
    wanted = evaluate_one(p.strands, height_m)
    strands = round(min(max(wanted, 1.0), float(MOST_STRANDS)))
    check_budget("branch segments", 2.0 * strands, _SEGMENT_BYTES, "fewer strands")
    angle, phyllotaxis = np.radians([p.angle_jitter_deg, p.phyllotaxis_jitter_deg])
    jitter = np.array([p.split_jitter, angle, angle, phyllotaxis, p.length_jitter])
    normals = rng.normal(size=(3 * strands, JITTERS)) if jitter.any() else np.zeros((1, JITTERS))
    trunk_m = float(np.clip(evaluate_one(p.trunk_length_m, height_m), 0.0, 20.0))
    giving_way = p.gravicentralism if p.gravicentralism_as == "printed" else 1.0 - p.gravicentralism
    tree, shape = divide(
        strands, max(1, p.lod), trunk_m, giving_way, np.radians(p.phyllotaxis_deg), *tables(p), jitter, normals
    )
    branching = Branching(*tree.T.copy(), *shape.T.copy())
    if not branching.length_m.sum() > 0.0:
        raise RecipeError("no branch of the plant has a length", where="plant", hint="trunk_length_m and length")
    scale = evaluate_one(p.scale_by_height, height_m)
    return replace(branching, length_m=scale * branching.length_m, scale=scale)


def skeleton_of(
    parameters: Parameters, branching: Branching, stance: Pose, organs: tuple[OrganPlacements, ...] = ()
) -> Skeleton:
    """The segments as nodes: their thickness is d = k_d sqrt(S_0) throughout, or of the exponent chosen."""
    strands = branching.strands.astype(np.float64)
    radius = 0.5 * parameters.thickness_m * branching.scale * strands**parameters.thickness_exponent
    return Skeleton.of(branching.parent, stance.position_m, radius, branching.gravelius, branching.axis, organs=organs)


def grow_at_rest(
    parameters: Parameters, height_m: float, rng: np.random.Generator
) -> tuple[Branching, Pose, tuple[OrganPlacements, ...], Floats]:
    """The tree without wind, in metres as Algorithm 1 gives them; its leaves; (N, 2) R_x and R_z of its segments."""
    form_rng, leaf_rng, wind_rng = rng.spawn(3)
    branching = branching_of(parameters, height_m, form_rng)
    phases_rad = wind_rng.uniform(0.0, 2.0 * np.pi, (len(branching.parent), 2))
    rest = pose(branching, Wind(), parameters.stiffness, phases_rad)
    organs: tuple[OrganPlacements, ...] = ()
    if parameters.leaves is not None:
        template = parameters.shapes[parameters.leaves.shape].template()
        organs = (leaf_places(parameters.leaves, template, branching, rest, height_m, leaf_rng),)
    return branching, rest, organs, phases_rad


class StrandGenerator:
    """Grows plants by Algorithm 1."""

    Parameters = Parameters  # the class that a recipe's `plant` block is checked against
    has_crown = True

    def grow(self, parameters: _Parameters, height_m: float, width_m: float, rng: np.random.Generator) -> Skeleton:
        """The tree in its wind, with its leaves; `width_m` is for the fit that follows."""
        branching, rest, organs, phases_rad = grow_at_rest(parameters, height_m, rng)
        stance = pose(branching, parameters.wind, parameters.stiffness, phases_rad)
        return skeleton_of(parameters, branching, stance, tuple(carried(one, rest, stance) for one in organs))

    def shaped(self, parameters: _Parameters, size: TreeSize) -> _Parameters:
        """See `plants.parameters.ShapesTrees`: a longer or shorter trunk below the first division."""
        own = evaluate_one(parameters.trunk_length_m, size.height_m)
        usual = float(np.clip(own * evaluate_one(parameters.scale_by_height, size.height_m) / size.height_m, 0.03, 0.9))
        wanted = float(np.clip(size.crown_base_m / size.height_m, 0.03, 0.9))
        length_m = own * (wanted / usual) * (1.0 - usual) / (1.0 - wanted)
        return parameters.model_copy(update={"trunk_length_m": ((0.0, length_m),)})

    def in_wind(self, parameters: _Parameters) -> _Parameters:
        """See `plants.parameters.Sways`."""
        if parameters.wind.speed_undirected * (1.0 - parameters.stiffness) > 0.0:
            return parameters
        breeze = parameters.wind.model_copy(update=_BREEZE)
        return parameters.model_copy(update={"wind": breeze, "stiffness": min(parameters.stiffness, _GIVING)})

    def poses(
        self,
        parameters: _Parameters,
        height_m: float,
        width_m: float,
        rng: np.random.Generator,
        times_s: Iterable[float],
        tree: TreeSize | None = None,
    ) -> Iterator[Skeleton]:
        """See `plants.parameters.Sways`. The fit is that of the plant at rest, so that its size does not breathe.

        Organs by foliage rules are placed at rest and carried along; `parameters.wind.time_s` does not count.
        """
        if parameters.variation is not None:
            raise RecipeError("a plant with a variation has no poses in the wind", where="plant.variation")
        if tree is not None:
            parameters = self.shaped(parameters, tree)
        wood_rng, foliage_rng, *_, leaf_rng = rng.spawn(5)  # as build_exemplar's
        branching, rest, organs, phases_rad = grow_at_rest(parameters, height_m, wood_rng)
        at_rest = skeleton_of(parameters, branching, rest, organs)
        placed = parameters.place_foliage(at_rest, height_m, foliage_rng)
        at_rest = replace(at_rest, organs=(*at_rest.organs, *placed))
        if tree is not None:
            yield from self._tree_poses(parameters, branching, rest, at_rest, phases_rad, leaf_rng, times_s, tree)
            return
        fitted = fit(at_rest, parameters.templates(), parameters.fit, height_m, width_m)
        stretch = _largest(fitted.position_m) / np.maximum(_largest(at_rest.position_m), 1e-9)
        for time_s in times_s:
            wind = parameters.wind.model_copy(update={"time_s": time_s})
            stance = pose(branching, wind, parameters.stiffness, phases_rad)
            organs = tuple(
                moved(carried(placement, rest, stance), stretch, _size(final) / max(_size(placement), 1e-12))
                for placement, final in zip(at_rest.organs, fitted.organs, strict=True)
            )
            yield replace(fitted, position_m=(stance.position_m * stretch).astype(np.float32), organs=organs)

    def _tree_poses(
        self,
        parameters: _Parameters,
        branching: Branching,
        rest: Pose,
        at_rest: Skeleton,
        phases_rad: Floats,
        leaf_rng: np.random.Generator,
        times_s: Iterable[float],
        tree: TreeSize,
    ) -> Iterator[Skeleton]:
        """Poses of a tree of given sizes: what sits on a segment keeps its place on it."""
        fitted = fit_tree(at_rest, parameters, parameters.templates(), tree, leaf_rng)
        still, base = fitted.skeleton, fitted.base.astype(np.int32)
        at_rest_m = replace(rest, position_m=fitted.points(rest.position_m))
        seat = still.position_m - at_rest_m.position_m[base]
        for time_s in times_s:
            wind = parameters.wind.model_copy(update={"time_s": time_s})
            stance = pose(branching, wind, parameters.stiffness, phases_rad)
            stance = replace(stance, position_m=fitted.points(stance.position_m))
            turn = (stance.rotation @ rest.rotation.transpose(0, 2, 1))[base]
            position_m = (stance.position_m[base] + np.einsum("nij,nj->ni", turn, seat)).astype(np.float32)
            organs = (carried(replace(one, node=base[one.node]), at_rest_m, stance) for one in still.organs)
            borne = zip(organs, still.organs, strict=True)
            yield replace(still, position_m=position_m, organs=tuple(replace(a, node=b.node) for a, b in borne))


def _largest(position_m: NDArray[np.float32]) -> Floats:
    return np.asarray(np.abs(position_m).max(axis=0), dtype=np.float64)


def _size(organs: OrganPlacements) -> float:
    """Length of a blade's unit; all organs of a plant are fitted by one factor."""
    return float(np.linalg.norm(organs.frame[:1, :, 1]))


GENERATOR = StrandGenerator()
