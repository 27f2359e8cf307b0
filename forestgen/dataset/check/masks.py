"""Masks: instance, part, semantic, coverage and branch modules agree with each other and with the table of plants.

Of plants.parquet that are pixels, areas, boxes, keypoints, and what each plant looks like alone.

A pixel has one plant_id, so masks are disjoint and their union, with the pixels of plant_id 0, is the image. That holds
by the file's form; the checks find two files that disagree.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.files import Finding, finding, read_bit_depth
from forestgen.dataset.check.frame_data import CAMERA, EXR, INSTANCE, PLANTS, SEMANTIC, FrameData, Wrong, frame_check

_PLANT_PARTS = (Part.TRUNK, Part.BRANCH, Part.LEAF, Part.FLOWER, Part.FRUIT, Part.DEAD_WOOD, Part.STRUCTURE)
_NAMES = {part.name.lower(): int(part) for part in Part}
_OTHERS = "others"
_SEMANTIC_BITS = 8
_LARGEST_PNG_ID = (1 << 24) - 1
_SUM_TOLERANCE = 1e-6
_MOST_NODES = 32  # of a branch module's prototype; nodes are below
_MOST_NUMBERS = 2**32 // _MOST_NODES  # a triangle's mark holds both in 32 bits
_SIZES = ("height_m", "radius_m", "age_yr", "distance_m", "leaf_area_m2", "crown_width_m")
_AREA_TOLERANCE = 1e-3  # relative; shares are stored as float32
_POINT_PX, _RELATIVE = 0.01, 1e-3  # places are stored as they are placed, to within float32 at the least
_GRAZING = 1e-3  # depth by distance, below which a point may or may not count as behind the camera
_BOX = tuple(f"amodal_box_{side}" for side in "xywh")
_FULL = ("full_box_left", "full_box_top", "full_box_right", "full_box_bottom")
_TOLERANCE = 1e-6
_EDGE_PX = 0.01  # rounding of projected vertices against rays
KEYPOINTS = ("stem_base", "tip", "crown_centre")
KEYPOINT_COLUMNS = tuple(f"{name}_{end}" for name in KEYPOINTS for end in ("x_px", "y_px", "state"))
_STATES = np.array(["0: outside the image", "1: hidden", "2: visible"])


@frame_check("ids", PLANTS)
def ids(frame: FrameData) -> Iterator[Finding | Wrong]:
    """plants.parquet holds each plant once, ids rising, and all that the image shows."""
    known = frame.plants["plant_id"]
    if known.dtype != np.uint32:
        yield finding("plant_id has another type", "uint32, no null", known.dtype)
        return
    steps = np.diff(known.astype(np.int64), prepend=-1)
    yield Wrong(steps <= 0, "ids do not rise from row to row, or one comes twice")
    if len(known) and known[0] == 0:
        yield finding("0 is no plant", "ids from 1", 0)
    strange = ~np.isin(frame.instance, known) & (frame.instance != 0)
    yield Wrong(strange, "a plant of the image is not in the table", "a row of it", "none")
    names = frame.plants["species"].tolist()
    for name in sorted(set(names) - set(frame.recipe["species"]), key=str):
        plant, expected = int(known[names.index(name)]), ", ".join(frame.recipe["species"])
        yield finding("the species is not the recipe's", expected, name, plant)


@frame_check("instance", INSTANCE, files=(INSTANCE,))
def instance_png(frame: FrameData) -> Iterator[Finding | Wrong]:
    """instance.png holds frame.exr's identity.plant_id, id = R + 256 G + 65536 B, if all ids fit 24 bits."""
    if int(frame.instance.max(initial=0)) > _LARGEST_PNG_ID:
        return
    rgb = frame.picture(INSTANCE).astype(np.uint32)
    if rgb.ndim != 3:
        yield finding("the picture has no three colours", "8-bit RGB", "one channel")
        return
    coded = rgb[..., 0] + 256 * rgb[..., 1] + 65536 * rgb[..., 2]
    yield Wrong(coded != frame.instance, "the id differs from frame.exr's", frame.instance, coded)


@frame_check("part", EXR)
def parts(frame: FrameData) -> Iterator[Wrong]:
    """A plant's pixel has a plant's part; no plant's has another part or is the sky."""
    part, is_plant = frame.part, frame.instance != 0
    yield Wrong(part >= len(Part), "no such part", f"0 to {len(Part) - 1}", part)
    own = np.isin(part, [int(one) for one in _PLANT_PARTS])
    names = "a part of a plant: trunk, branch, leaf, flower, fruit or dead wood; or a structure"
    yield Wrong(is_plant & ~own, "a plant's pixel has no plant's part", names, part)
    yield Wrong(~is_plant & own, "a pixel of no plant has a plant's part", "sky, ground or what lies on it", part)


@frame_check("semantic", SEMANTIC)
def semantic(frame: FrameData) -> Iterator[Finding | Wrong]:
    """semantic.png, of 8 bits a pixel, is frame.exr's identity.semantic, and both follow from species and part."""
    if frame.has(SEMANTIC):
        shown = frame.picture(SEMANTIC)
        if shown.ndim != 2:
            yield finding("the picture is no palette's", "8-bit indices", "colours")
            return
        bits = read_bit_depth(frame.root, frame.file(SEMANTIC))
        if bits != _SEMANTIC_BITS:
            yield finding("bits of a pixel", _SEMANTIC_BITS, bits)
        yield Wrong(shown != frame.semantic, "the class differs from frame.exr's semantic", frame.semantic, shown)
    expected = _classes(frame)
    problem = "the class does not follow from the plant's species and the part"
    yield Wrong(expected != frame.semantic, problem, expected, frame.semantic, EXR)


def _classes(frame: FrameData) -> NDArray[np.int64]:
    """(H, W) class by the recipe: 0 sky, 1 ground, then its classes; a part's class goes before a species'."""
    recipe = frame.recipe
    species = recipe["species"]
    own = recipe["labels"].get("classes") or {name: [name] for name in species}
    number_of = {member: number for number, members in enumerate(own.values(), start=2) for member in members}
    by_part = {_NAMES[name]: number for name, number in number_of.items() if name in _NAMES and name not in species}
    rest = number_of.get(_OTHERS, 1)
    by_species = {name: number_of.get(name, rest) for name in species}
    column = np.array([by_species.get(name, -1) for name in frame.plants["species"].tolist()], dtype=np.int64)
    found = np.ones(frame.instance.shape, dtype=np.int64)
    is_plant = frame.instance != 0
    rows = np.searchsorted(frame.plants["plant_id"], frame.instance[is_plant])
    found[is_plant] = column[np.minimum(rows, len(column) - 1)] if len(column) else -1
    for part, number in by_part.items():
        found[frame.part == part] = number
    found[frame.part == int(Part.NOTHING)] = 0
    return found


@frame_check("coverage", EXR, exr=("coverage rank0.id rank0.coverage",))
def coverage(frame: FrameData) -> Iterator[Wrong]:
    """Each share lies in (0, 1], they fall, sum to 1 (up to 1 where ranks ran out), and rank 0 is the instance."""
    ids, share = frame.ranks
    total = share.sum(axis=-1, dtype=np.float64)
    outside = np.any(~((share >= 0) & (share <= 1)), axis=-1)
    yield Wrong(outside, "a coverage lies outside 0 to 1", "0 to 1", share)
    rises = np.any(~(share[..., 1:] <= share[..., :-1]), axis=-1)
    yield Wrong(rises, "coverages do not fall from rank to rank", "falling", share)
    yield Wrong(~(total <= 1 + _SUM_TOLERANCE), "coverages sum to more than 1", "1", total)
    open_rank = (share[..., -1] == 0) & ~(np.abs(total - 1) <= _SUM_TOLERANCE)
    yield Wrong(open_rank, "coverages do not sum to 1 though ranks are free", f"1 ± {_SUM_TOLERANCE:g}", total)
    first = ids[..., 0]
    yield Wrong(first != frame.instance, "rank 0 is not the instance mask's plant", frame.instance, first)
    nameless = np.any((share == 0) & (ids != 0), axis=-1)
    yield Wrong(nameless, "a rank without coverage names a plant", "0", ids)
    tied = (share[..., 1:] > 0) & (share[..., 1:] == share[..., :-1])
    unsorted = np.any(tied & (ids[..., 1:] <= ids[..., :-1]), axis=-1)
    yield Wrong(unsorted, "equal coverages are not in the order of ids", "rising ids", ids)
    repeated = np.zeros(frame.instance.shape, dtype=bool)
    for rank in range(1, ids.shape[-1]):
        again = (ids[..., :rank] == ids[..., rank : rank + 1]).any(axis=-1)
        repeated |= again & (share[..., rank] > 0)
    yield Wrong(repeated, "an id has two ranks", "each id once", ids)


@frame_check("modules", EXR, exr=("module number node own",))
def branches(frame: FrameData) -> Iterator[Wrong]:
    """Numbers within their ranges; a plant's pixels have a module all or none, and no ground, sky or house has one."""
    module = frame.exr["module"]
    number, node, own = module["number"], module["node"], module["own"]
    for name, values, most in (("number", number, _MOST_NUMBERS), ("node", node, _MOST_NODES - 1), ("own", own, 1)):
        yield Wrong(values > most, f"module.{name} is out of range", f"at most {most}", values)
    for name, values in (("node", node), ("own", own)):
        without = (number == 0) & (values != 0)
        yield Wrong(without, f"module.{name} is set where there is no module", "0", values)
    if not frame.has_part("identity", "centre.plant_id", "centre.part"):
        return
    plant, part = frame.exr["identity"]["centre.plant_id"], frame.exr["identity"]["centre.part"]
    nowhere = (number != 0) & ((plant == 0) | (part == int(Part.STRUCTURE)))
    yield Wrong(nowhere, "a module of no plant", "0", number)
    _, index = np.unique(plant, return_inverse=True)
    index = index.reshape(plant.shape)
    has_some = np.bincount(index[number != 0], minlength=index.max() + 1) > 0
    is_own = np.bincount(index[own == 1], minlength=index.max() + 1) > 0
    torn = (plant != 0) & (number == 0) & has_some[index]
    yield Wrong(torn, "a plant of modules has none here", "a module's number", number)
    mixed = (plant != 0) & (number != 0) & (own == 0) & is_own[index]
    yield Wrong(mixed, "a plant's branches are its own in other pixels only", "1", own)


@frame_check("plants", PLANTS)
def visible(frame: FrameData) -> Iterator[Wrong]:
    """visible_pixels, box and truncated are those of the mask."""
    extents, plants = frame.extents, frame.plants
    row = np.array([extents.row_of.get(plant, -1) for plant in plants["plant_id"].tolist()], dtype=np.int64)
    is_seen = row >= 0
    pixels = np.append(extents.pixels, 0)[row]
    expected = np.concatenate([extents.box_px, np.zeros((1, 4), dtype=np.int64)])[row]
    box = _columns(frame, *(f"box_{side}" for side in "xywh"))
    yield Wrong(plants["visible_pixels"] != pixels, _differs("visible_pixels"), pixels, plants["visible_pixels"])
    yield Wrong(~is_seen & ~np.isnan(box).all(axis=1), _differs("box of an unseen plant"), "null", box)
    yield Wrong(is_seen & (box != expected).any(axis=1), _differs("box x, y, w, h"), expected, box)
    far = expected[:, :2] + expected[:, 2:]
    touches = is_seen & ((expected[:, :2] == 0) | (far == frame.size_px)).any(axis=1)
    truncated = plants["truncated"]
    yield Wrong(truncated.astype(bool) != touches, _differs("truncated"), touches, truncated)


@frame_check("areas", PLANTS, exr=("coverage rank0.id rank0.coverage",))
def areas(frame: FrameData) -> Iterator[Wrong]:
    """visible_area_px is the sum of coverages; where 8 ranks did not hold all ids it may be more."""
    ids, share = frame.ranks
    known = frame.plants["plant_id"]
    filled = (share > 0) & (ids != 0)
    rows = np.searchsorted(known, ids[filled])
    listed = rows < len(known)
    least = np.bincount(rows[listed], weights=share[filled][listed], minlength=len(known))
    rest = float(np.maximum(1 - share.sum(axis=-1, dtype=np.float64), 0)[share[..., -1] > 0].sum())
    area = frame.plants["visible_area_px"]
    slack = _AREA_TOLERANCE * np.maximum(least, 1)
    yield Wrong(~((area >= least - slack) & (area <= least + slack + rest)), _differs("visible_area_px"), least, area)


@frame_check("stems", PLANTS, columns=("stem_pixels",))
def stems(frame: FrameData) -> Iterator[Wrong]:
    """stem_pixels counts the plant's pixels whose part is the trunk."""
    known = frame.plants["plant_id"]
    trunk = frame.instance[(frame.part == int(Part.TRUNK)) & (frame.instance != 0)]
    rows = np.searchsorted(known, trunk)
    count = np.bincount(rows[rows < len(known)], minlength=len(known))
    stored = frame.plants["stem_pixels"]
    yield Wrong(~(stored == count), _differs("stem_pixels"), count, stored)


@frame_check("measures", PLANTS)
def measures(frame: FrameData) -> Iterator[Wrong]:
    """Measures that every plant has are finite numbers, sizes not negative."""
    for column in filter(frame.known, ("x_m", "y_m", "z_m", *_SIZES)):
        values = frame.plants[column].astype(np.float64)
        least = 0.0 if column in _SIZES else -np.inf
        yield Wrong(~(np.isfinite(values) & (values >= least)), f"{column} is no measure", "a number", values)


@frame_check("keypoints", PLANTS, columns=KEYPOINT_COLUMNS)
def keypoints(frame: FrameData) -> Iterator[Finding]:
    """State is 0 outside the image; inside, 2 where the mask's pixel is the plant's, and 1 elsewhere."""
    plants = frame.plants
    for name in KEYPOINTS:
        x, y = _columns(frame, f"{name}_x_px", f"{name}_y_px").T
        expected = keypoint_states(x, y, plants["plant_id"], frame.instance)
        got = plants[f"{name}_state"]
        for row in np.flatnonzero(~(got == expected)):
            problem, plant = f"{name}_state does not follow from the mask", int(plants["plant_id"][row])
            pixel = (int(x[row]), int(y[row])) if expected[row] else None
            yield finding(problem, _STATES[expected[row]], got[row], plant, pixel=pixel)


def keypoint_states(
    x: NDArray[np.float64], y: NDArray[np.float64], plant_id: NDArray[np.uint32], instance: NDArray[np.uint32]
) -> NDArray[np.int64]:
    """(N,) states of points at x, y (N,) of plants; NaN lies outside."""
    height, width = instance.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    column = np.where(inside, x, 0).astype(np.int64)
    line = np.where(inside, y, 0).astype(np.int64)
    seen = instance[line, column] == plant_id
    return np.where(inside, np.where(seen, 2, 1), 0)


@frame_check(
    "stem places", PLANTS,
    files=(CAMERA,), columns=("x_m", "y_m", "z_m", "stem_base_x_px", "stem_base_y_px"),
)  # fmt: skip
def places(frame: FrameData) -> Iterator[Finding]:
    """The stem base is where the camera projects the plant's place; none where it cannot see it."""
    camera = frame.camera
    own = camera.in_own_axes(_columns(frame, "x_m", "y_m", "z_m") - camera.position_m)
    expected, depth = camera.geometry.project(own)
    got = _columns(frame, "stem_base_x_px", "stem_base_y_px")
    off = np.abs(got - expected)
    if camera.projection.wraps_x:
        off[:, 0] = np.minimum(off[:, 0], np.abs(off[:, 0] - camera.size_px[0]))  # at the seam: either end
    there = ~np.isnan(got).any(axis=1)
    sure = np.abs(depth) > _GRAZING * np.sqrt((own**2).sum(axis=1))
    beyond_px = camera.geometry.beyond_rim_px(expected)
    if beyond_px is not None:
        sure = np.abs(beyond_px) > _POINT_PX
    wrong = sure & (there != (depth > 0))
    wrong |= there & sure & ~(off <= _POINT_PX + _RELATIVE * np.abs(expected)).all(axis=1)
    problem = "stem_base_x_px, stem_base_y_px are not the plant's place as the camera sees it"
    for row in np.flatnonzero(wrong):
        place = expected[row] if depth[row] > 0 else "null: not in view"
        yield finding(problem, place, got[row], int(frame.plants["plant_id"][row]))


@frame_check(
    "amodal", PLANTS,
    columns=("amodal_pixels", "amodal_area_px", "visible_fraction", *_BOX),
    when=lambda frame: not np.isnan(_columns(frame, "amodal_area_px")).all(),
)  # fmt: skip
def amodal(frame: FrameData) -> Iterator[Wrong]:
    """Visible pixels, box and fraction lie within the amodal ones, these within the image and the full box."""
    area, visible_area, fraction = _columns(frame, "amodal_area_px", "visible_area_px", "visible_fraction").T
    pixels, seen = _columns(frame, "amodal_pixels", "visible_pixels").T
    has_mask, filled = ~np.isnan(area), pixels > 0
    width, height = frame.size_px
    box, own = _columns(frame, *_BOX), _columns(frame, *(f"box_{side}" for side in "xywh"))
    yield Wrong((seen > 0) & ~has_mask, "a plant of the image has no amodal mask", "one", pixels)
    yield Wrong(has_mask & ~(pixels >= seen), "amodal_pixels is less than visible_pixels", seen, pixels)
    yield Wrong(filled == np.isnan(box).any(axis=1), "amodal_box and amodal_pixels disagree", "both", box)
    inside = np.all(box[:, :2] >= 0, axis=1) & (box[:, 0] + box[:, 2] <= width) & (box[:, 1] + box[:, 3] <= height)
    yield Wrong(filled & ~inside, "amodal_box leaves the image", f"within {width} x {height}", box)
    room = box[:, 2] * box[:, 3]
    yield Wrong(filled & ~(pixels <= room), "amodal_box is smaller than amodal_pixels", pixels, room)
    low = own[:, :2] >= box[:, :2]
    high = own[:, :2] + own[:, 2:] <= box[:, :2] + box[:, 2:]
    has_box = ~np.isnan(own).any(axis=1)
    yield Wrong(has_box & ~np.all(low & high, axis=1), "the box is not within amodal_box", own, box)
    yield Wrong(has_mask & ~(area >= 0), "amodal_area_px is no area", "0 or more", area)
    expected = np.minimum(np.divide(visible_area, area, out=np.full(len(area), np.nan), where=area > 0), 1.0)
    agree = (np.abs(fraction - expected) <= _TOLERANCE) | (np.isnan(fraction) & np.isnan(expected))
    yield Wrong(~agree, "visible_fraction is not visible by amodal area", expected, fraction)
    if all(map(frame.known, _FULL)):
        yield from _full_boxes(frame, box, filled)


def _full_boxes(frame: FrameData, box: NDArray[np.float64], filled: NDArray[np.bool_]) -> Iterator[Wrong]:
    width, height = frame.size_px
    full = _columns(frame, *_FULL)
    known = ~np.isnan(full).any(axis=1)
    yield Wrong(filled & ~known, "a plant with an amodal mask has no full box", "four numbers", full)
    low = np.floor(full[:, :2] - _EDGE_PX) <= box[:, :2]
    high = np.ceil(full[:, 2:] + _EDGE_PX) >= box[:, :2] + box[:, 2:]
    yield Wrong(filled & known & ~(low & high).all(axis=1), "amodal_box is not within full_box", full, box)
    if frame.known("truncation"):
        kept = np.clip(full, 0, (width, height, width, height))
        extent = (full[:, 2] - full[:, 0]) * (full[:, 3] - full[:, 1])
        part = np.maximum(kept[:, 2] - kept[:, 0], 0) * np.maximum(kept[:, 3] - kept[:, 1], 0)
        share = 1 - np.divide(part, extent, out=np.ones_like(part), where=extent > 0)
        got = frame.plants["truncation"].astype(np.float64)
        wrong = known & (extent > 0) & ~(np.abs(got - share) <= _TOLERANCE)
        yield Wrong(wrong, "truncation is not the full box' share outside the image", share, got)
        yield Wrong(known & ~((got >= 0) & (got <= 1)), "truncation lies outside 0 to 1", "0 to 1", got)


def _columns(frame: FrameData, *names: str) -> NDArray[np.float64]:
    """(N, columns) numbers of plants.parquet."""
    return np.stack([frame.plants[name].astype(np.float64) for name in names], axis=1)


def _differs(column: str) -> str:
    return f"{column} differs from the mask's"
