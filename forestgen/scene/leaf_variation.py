"""Leaves that differ within crowns and between plants.

The leaves of a crown belong to three classes of equal area, by the leaf area above them in columns of cells: sun
leaves, those between, and shade leaves. Sun leaves are thicker and, where they are broad, have more chlorophyll per
area. Plants of a species differ in chlorophyll by 15% (standard deviation): so do the means of plots, and leaves of one
plot and height by 16%. Both come from the table ``standards/leaf_variation``: what measured leaves have over the mean
leaf of their species, as factors on the reflectance and transmittance of that leaf's spectrum, whatever its season. See
`docs/spectra/make_leaves.py` for the measurements.

Near a camera single leaves differ too. Broad leaves differ in chlorophyll; the crown's mean stays. Where a crown has
leaves of several seasons, each leaf is of one of them. At any time of the year a few are yellow or dead: at most 2.2%
together, as crowns without discoloration have up to 10% (ICP Forests' class 0; the shares are our estimate). Needles of
this year's shoots of evergreens, the outer ends of sprays, are pale from May (Norway spruce; our estimate) until they
have their chlorophyll at the end of July: half of it is missing at first, as in young leaves of beech and oak, and none
after.

In autumn plants differ in stage, too: green, yellow and brown ones stand side by side. Where `plants.phenology_classes`
is 1 the plants of an exemplar have the colours of a day of their own, spread as the species' `autumn_sd_days`; as many
of their leaves have fallen as of the mean plant. More classes have their own colours, and leaves that fell.

Of a plant whose leaves are of several seasons, those that turned stand together: its green, coloured and withered
leaves are patches of 0.5 to 4 m, of the areas that their shares have. Shade-tolerant species turn from the outside,
others from the inside (Koike 1990: late and early successional ones); how much the place counts is ours.

Materials with `leaf_type` take part. An exemplar has one chlorophyll, so plants that share an exemplar are alike,
whatever their detail and season. One of its plants, of the lowest plant_id, decides on its place among the exemplars of
its species, which are evenly spread over the normal distribution: their standard deviation is that of plants, however
many there are, and with other numbers of exemplars plants keep their order of green. One alone is as green as the mean.
Far meshes around a site are of its plants, each with its leaves.

References
----------
Koike 1990 (Tree Physiology 7, 21-32). Serbin et al. 2014 (Ecological Applications 24, 1651-1669). Shiklomanov et al.
2016 (Remote Sensing of Environment 183, 226-238).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache
from statistics import NormalDist
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import part_of, triangle_areas
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.organs.sprays import LeafKind
from forestgen.recipe.phenology import TimeOfYear
from forestgen.recipe.spectra import SEASONS, Columns, load_table
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.spec import Material

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Materials = dict[tuple[str, str], Material]
Stages = Callable[[float], Sequence[float]]  # standard deviations late -> shares of `SEASONS`
CLASSES = ("sun", "middle", "shade")
_CELLS = 32  # along the crown's longest side
_LEAST = {"autumn": 0.015, "dry": 0.007}  # share of yellow and of dead leaves at any time
_NEW_NEEDLES = 0.2  # share that this year's shoots bear, of about five years
_PALEST = 4.0  # standard deviations of chlorophyll below the mean: about half
_FLUSH, _GREEN = 135.0, 210.0  # days of the year on which needles unfold, and are as green as old ones
_BY_SEASON = {"spring": 0.9, "summer": 0.3}  # paleness at a season without a date; others: none
# Broad leaves paler and deeper than others by chlorophyll, standard deviations, and the share of each: with those
# between, leaves of one plant and height differ as measured ones do.
_GREENS, _EITHER_SIDE = {"pale": 1.4, "deep": -1.4}, 0.25
_WAVES, _PATCHES_M = 24, (0.5, 4.0)  # that make patches of turned leaves, and their lengths
_OUTSIDE = 0.8  # by how much sun leaves turn before, standard deviations of the waves
_LEAST_MIXED = 0.02  # share of another season from which on a crown has patches
_RAREST = 0.02  # share of plants that are cut off at each end of the distribution


def vary_leaves(
    exemplars: Sequence[Exemplar],
    materials: Mapping[tuple[str, str], Material],
    plant: Ints,
    seed: int,
    stages: Mapping[str, Stages] = MappingProxyType({}),
    inside_first: Collection[str] = (),
) -> tuple[tuple[Exemplar, ...], Materials]:
    """Exemplars with their leaves in classes, and the materials of all.

    `plant`: (E,) id of the plant that decides on each exemplar's chlorophyll, see `ExemplarPlan.first_plant`; 0: none.
    `stages`: of species whose plants are early or late in autumn by their colours alone, see `colour_stages`.
    `inside_first`: species whose crowns turn from the inside.
    """
    found, varied = dict(materials), []
    species = [one.species for one in exemplars]
    greens, lates = (_deviations(species, plant, seed, what) for what in ("leaf chlorophyll", "leaf stage"))
    for exemplar, number, deviation, late in zip(
        exemplars, plant.tolist(), greens.tolist(), lates.tolist(), strict=True
    ):
        leafy = [
            organ
            for organ in exemplar.organs
            if organ.part == Part.LEAF
            and organ.mesh.triangles
            and materials[exemplar.species, organ.material].leaf_type is not None
        ]
        if not leafy:
            varied.append(exemplar)
            continue
        bases = {organ.material: materials[exemplar.species, organ.material] for organ in leafy}
        if number and exemplar.species in stages:
            bases = {name: _at_stage(base, stages[exemplar.species](late)) for name, base in bases.items()}
        by_light = light_classes(leafy)
        outside = -_OUTSIDE if exemplar.species in inside_first else _OUTSIDE
        rng = child_rng(seed, "turned leaves", exemplar.species, number)
        classes = iter(zip(by_light, _turned(leafy, by_light, bases, outside, rng), strict=True))
        organs: list[OrganMesh] = []
        for organ in exemplar.organs:
            if not any(organ is one for one in leafy):
                organs.append(organ)
                continue
            light, season = next(classes)
            for index, of in np.unique([light, season], axis=1).T.tolist():
                base = bases[organ.material]
                part = "" if of < 0 else f", {SEASONS[of]}"
                name = f"{organ.material} ({CLASSES[index]}, {number}{part})"
                key = exemplar.species, name
                if key not in found:
                    if of >= 0:
                        base = _at_stage(base, _season_alone(base, of))
                    found[key] = varied_material(base, CLASSES[index], deviation)
                organs.append(_some_faces(organ, (light == index) & (season == of), name))
        varied.append(replace(exemplar, organs=tuple(organs)))
    return tuple(varied), found


def _is_mixed(base: Material) -> bool:
    """Whether a crown has leaves that have turned beside others."""
    if len(base.seasons) < len(SEASONS) or base.reflectance_spectrum is None or base.transmittance_spectrum is None:
        return False
    _, _, autumn, dry = (one.share for one in base.seasons)
    return autumn + dry > _LEAST_MIXED and max(autumn, dry, 1.0 - autumn - dry) < 1.0 - _LEAST_MIXED


def _turned(
    leafy: Sequence[OrganMesh],
    by_light: Sequence[NDArray[np.intp]],
    bases: Mapping[str, Material],
    outside: float,
    rng: np.random.Generator,
) -> list[NDArray[np.intp]]:
    """(F,) of each organ, index into `SEASONS` of faces, summer for all green ones; -1: of leaves that are all alike.

    `outside`: by how much leaves in the sun turn before those between, standard deviations.
    """
    if not any(_is_mixed(base) for base in bases.values()):
        return [np.full(len(one), -1) for one in by_light]
    shortest_m, longest_m = _PATCHES_M
    length_m = shortest_m * (longest_m / shortest_m) ** rng.random(_WAVES)
    direction, phase = rng.normal(size=(_WAVES, 3)), rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    waves = 2.0 * np.pi * direction / (length_m * np.linalg.norm(direction, axis=1))[:, None]
    early = []
    for organ, light in zip(leafy, by_light, strict=True):
        middle = organ.mesh.vertices_m[organ.mesh.faces].mean(axis=1)
        sines = sum((np.sin(middle @ wave + start) for wave, start in zip(waves, phase, strict=True)), np.zeros(1))
        early.append(sines / np.sqrt(0.5 * _WAVES) - outside * (light - 1.0))
    area = np.concatenate([triangle_areas(organ.mesh.vertices_m, organ.mesh.faces) for organ in leafy])
    order = np.argsort(-np.concatenate(early), kind="stable")
    before = np.empty(len(order))  # share of the crown's leaf area that turns before each face
    before[order] = (np.cumsum(area[order]) - 0.5 * area[order]) / area.sum()
    turned = []
    for organ, share in zip(leafy, np.split(before, np.cumsum([len(one) for one in early])[:-1]), strict=True):
        base = bases[organ.material]
        if not _is_mixed(base):
            turned.append(np.full(len(share), -1))
            continue
        _, _, autumn, dry = (one.share for one in base.seasons)
        turned.append(np.where(share < dry, 3, np.where(share < dry + autumn, 2, 1)))
    return turned


def _season_alone(base: Material, of: int) -> Sequence[float]:
    """Shares of `SEASONS`; green leaves are of spring and summer as they are in the crown."""
    if of > 1:
        return [float(one == of) for one in range(len(SEASONS))]
    spring, summer, _, _ = (one.share for one in base.seasons)
    young = spring / max(spring + summer, 1e-9)
    return young, 1.0 - young, 0.0, 0.0


def _at_stage(base: Material, shares: Sequence[float]) -> Material:
    """A leaf of other shares of `SEASONS`; of a species without spectra of them all, itself."""
    before, through = base.reflectance_spectrum, base.transmittance_spectrum
    if len(base.seasons) < len(shares) or before is None or through is None:
        return base
    seasons = tuple(one._replace(share=share) for one, share in zip(base.seasons, shares, strict=True))

    def mean(old: Spectrum, side: str) -> Spectrum:
        grid, known = old.wavelength_nm, [(one.share, getattr(one, side)) for one in seasons if one.share > 0.0]
        return Spectrum(grid, np.sum([share * one.at(grid) for share, one in known], axis=0))

    varied = _of_spectra(base, mean(before, "reflectance"), mean(through, "transmittance"))
    return replace(varied, seasons=seasons)


def _deviations(species: Sequence[str], plant: Ints, seed: int, what: str) -> Floats:
    """(E,) standard deviations of each exemplar's chlorophyll below the mean, or earliness; see `vary_leaves`."""
    deviation = np.zeros(len(plant))
    for name in {one for one, number in zip(species, plant.tolist(), strict=True) if number}:
        mine = np.array([one == name for one in species]) & (plant > 0)
        ids, which = np.unique(plant[mine], return_inverse=True)
        order = np.argsort([child_rng(seed, what, name, one).random() for one in ids.tolist()])
        even = _RAREST + (1.0 - 2.0 * _RAREST) * (np.argsort(order) + 0.5) / len(ids)
        normal = np.array([NormalDist().inv_cdf(one) for one in even.tolist()])
        deviation[mine] = (normal / (float(normal.std()) or 1.0))[which.reshape(-1)]
    return deviation


def light_classes(leafy: Sequence[OrganMesh]) -> list[NDArray[np.intp]]:
    """(F,) class of each face of each organ of a crown, index into `CLASSES`."""
    corners = [organ.mesh.vertices_m.T[:, organ.mesh.faces.T] for organ in leafy]  # (3, 3, F): coordinate, corner, face
    place = np.concatenate([one[:, 0] for one in corners], axis=1)
    area = np.concatenate([_areas(one) for one in corners])
    low, extent = place.min(axis=1), np.ptp(place, axis=1)
    side = max(float(extent.max()) / _CELLS, 1e-6)
    shape = tuple((extent / side).astype(np.int64) + 1)
    cell = np.ravel_multi_index(tuple(((place - low[:, None]) / side).astype(np.int64)), shape)
    leaf = np.bincount(cell, weights=area, minlength=int(np.prod(shape))).reshape(shape)
    above = np.cumsum(leaf[:, :, ::-1], axis=2)[:, :, ::-1] - 0.5 * leaf
    order = np.argsort(above, axis=None, kind="stable")
    share = np.empty(leaf.size)
    share[order] = (np.cumsum(leaf.ravel()[order]) - 0.5 * leaf.ravel()[order]) / leaf.sum()
    of_face = np.minimum((share[cell] * len(CLASSES)).astype(np.intp), len(CLASSES) - 1)
    return np.split(of_face, np.cumsum([one.shape[2] for one in corners])[:-1])


def varied_material(base: Material, light: str, deviation: float) -> Material:
    """A leaf of a class of light on a plant whose chlorophyll is `deviation` standard deviations below the mean."""
    if base.reflectance_spectrum is None:
        return base
    table, kind = _factors(), base.leaf_type
    grid = base.reflectance_spectrum.wavelength_nm
    values = []
    for side, spectrum in (("reflectance", base.reflectance_spectrum), ("transmittance", base.transmittance_spectrum)):
        if spectrum is None:
            values.append(np.zeros(len(grid)))
            continue
        factor = table[f"{kind}_pale_{side}"].at(grid) ** deviation
        if light != "middle":
            factor = factor * table[f"{kind}_{light}_{side}"].at(grid)
        values.append(factor * spectrum.at(grid))
    sum_of_both = np.maximum(values[0] + values[1], 1.0)
    reflectance = Spectrum(grid, values[0] / sum_of_both)
    transmittance = None if base.transmittance_spectrum is None else Spectrum(grid, values[1] / sum_of_both)
    return _of_spectra(base, reflectance, transmittance)


def single_leaves(base: Material, time: TimeOfYear, is_evergreen: bool) -> tuple[tuple[LeafKind, Material], ...]:
    """Kinds of leaves in a crown near a camera, whose mean is the crown's; the last is what most of them are.

    `is_evergreen`: needles of this year differ from older ones; without older ones the crown's mean is theirs already.
    """
    if base.reflectance_spectrum is None or base.leaf_type is None or not base.seasons:
        return ()
    main = max(base.seasons, key=lambda one: one.share)
    kinds = [
        (
            LeafKind(one.name, max(one.share, _LEAST.get(one.name, 0.0))),
            _of_spectra(base, one.reflectance, one.transmittance),
        )
        for one in base.seasons
        if one is not main and max(one.share, _LEAST.get(one.name, 0.0)) > 0.0
    ]
    pale = _paleness(time)
    if base.leaf_type == "needle" and is_evergreen and pale > 0.0:
        kinds.append((LeafKind("new", _NEW_NEEDLES, at_tip=True), varied_material(base, "middle", _PALEST * pale)))
    left = _without(base, kinds)
    if base.leaf_type == "broad":
        share = _EITHER_SIDE * (1.0 - sum(kind.share for kind, _ in kinds))
        kinds += [
            (LeafKind(name, share), varied_material(left, "middle", deviation)) for name, deviation in _GREENS.items()
        ]
        left = _without(base, kinds)
    return (*kinds, (LeafKind(main.name, 1.0 - sum(kind.share for kind, _ in kinds)), left))


def _without(mean: Material, kinds: Sequence[tuple[LeafKind, Material]]) -> Material:
    """The leaves of a mean that are of none of some kinds."""
    share = 1.0 - sum(kind.share for kind, _ in kinds)
    assert mean.reflectance_spectrum is not None
    reflectance = _rest(
        mean.reflectance_spectrum, [(kind.share, one.reflectance_spectrum) for kind, one in kinds], share
    )
    transmittance = None
    if mean.transmittance_spectrum is not None:
        others = [(kind.share, one.transmittance_spectrum) for kind, one in kinds]
        transmittance = _rest(mean.transmittance_spectrum, others, share)
    return _of_spectra(mean, reflectance, transmittance)


def _rest(mean: Spectrum, others: Sequence[tuple[float, Spectrum | None]], share: float) -> Spectrum:
    """Spectrum of a share of the leaves, whose others have theirs."""
    grid = mean.wavelength_nm
    known = [part * one.at(grid) for part, one in others if one is not None]
    return Spectrum(grid, np.clip((mean.at(grid) - np.sum(known, axis=0)) / share, 0.0, 1.0))


def _paleness(time: TimeOfYear) -> float:
    """Of needles of this year's shoots: 1 as they unfold, 0 from summer on."""
    if time.season is not None:
        return _BY_SEASON.get(time.season, 0.0)
    if time.is_tropical or time.northern_day < _FLUSH:
        return 0.0
    return max(1.0 - (time.northern_day - _FLUSH) / (_GREEN - _FLUSH), 0.0)


def _of_spectra(base: Material, reflectance: Spectrum, transmittance: Spectrum | None) -> Material:
    colours = colours_of_surface(reflectance, transmittance)
    return replace(
        base,
        reflectance=colours[0],
        transmittance=colours[1],
        reflectance_spectrum=reflectance,
        transmittance_spectrum=transmittance,
    )


def _areas(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """(F,) areas of triangles."""
    (x, y, z), (u, v, w) = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(0.5 * np.sqrt((y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2))


@cache
def _factors() -> Columns:
    return load_table("standards/leaf_variation")


def _some_faces(organ: OrganMesh, chosen: NDArray[np.bool_], material: str) -> OrganMesh:
    mark = None if organ.mark is None else organ.mark[chosen]
    own = None if organ.organ is None else organ.organ[chosen]
    return OrganMesh(organ.part, material, part_of(organ.mesh, organ.mesh.faces[chosen]), mark, own)
