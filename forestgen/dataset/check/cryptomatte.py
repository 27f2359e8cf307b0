"""cryptomatte.exr against frame.exr: names hash to ids, and plants have the shares of the coverage's ranks.

Where the recipe leaves coverage out, shares are held against the instance mask: its plant has the largest.

References
----------
Psyop, "Cryptomatte specification", version 1.2.0. Appleby, MurmurHash3, x86, 32 bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.files import Finding, as_text, finding, read_exr
from forestgen.dataset.check.frame_data import FrameData, Wrong, frame_check
from forestgen.dataset.check.masks import coverage
from forestgen.dataset.safe_path import load_json

_FILE = "cryptomatte.exr"
_LAYER = "CryptoPlant"
_RANKS = 8
_TOLERANCE = 1e-6


@frame_check("cryptomatte", _FILE, files=(_FILE,))
def cryptomatte(frame: FrameData) -> Iterator[Finding | Wrong]:
    """Every name has the standard's id; plants and shares are those of frame.exr's ranks, or suit its mask."""
    parts, header = read_exr(frame.root, frame.file(_FILE))
    channels = next(iter(parts.values()))
    manifests = _manifests(header)
    for layer, names in manifests.items():
        for name, code in names.items():
            expected = f"{standard_id(name):08x}"
            if int(code, 16) != int(expected, 16):
                yield finding(f"{layer}: the id of {name} is not its hash", expected, code)
    plant_of = {int(code, 16): int(name.rpartition("_")[2]) for name, code in manifests[_LAYER].items()}
    for plant in sorted(set(plant_of.values()) - set(frame.row_of)):
        yield finding("a named plant is not in plants.parquet", "a row of it", plant_id=plant)
    levels = [(f"{_LAYER}{rank // 2:02d}", ("RG", "BA")[rank % 2]) for rank in range(_RANKS)]
    ids = np.stack(
        [np.ascontiguousarray(channels[f"{one}.{pair[0]}"]).view(np.uint32) for one, pair in levels], axis=-1
    )
    share = np.stack([channels[f"{one}.{pair[1]}"] for one, pair in levels], axis=-1)
    if share.shape[:2] != frame.instance.shape:
        yield finding("the picture has another size than frame.exr", got=share.shape[1::-1])
        return
    if not coverage.applies(frame):
        yield from _by_mask(frame, _plants(ids, plant_of), share)
        return
    ranks, rank_share = frame.ranks
    at = np.nonzero((ids != 0).any(axis=-1) | (ranks != 0).any(axis=-1))
    plants = _plants(ids[at], plant_of)
    wanted, shares = _without_background(ranks[at], rank_share[at])
    got_share = np.where(plants != 0, share[at], np.float32(0.0))
    # frame.exr gives one of its ranks to the background, so cryptomatte.exr may hold one plant more.
    differs = (shares > 0) & ((wanted != plants) | ~(np.abs(shares - got_share) <= _TOLERANCE))
    more = (rank_share[at][:, -1:] == 0) & (shares == 0) & (got_share > 0)
    for wrong, problem in (
        (plants < 0, "an id is not in the manifest"),
        (differs, "plants or shares are not those of frame.exr's coverage"),
        (more, "a plant is covered that frame.exr's coverage has not"),
    ):
        image = np.zeros(frame.instance.shape, dtype=bool)
        image[at] = wrong.any(axis=-1)
        if image.any():
            row = int(np.argmax(wrong.any(axis=-1)))  # the first: rows are in the order of pixels
            yield Wrong(image, problem, as_text(wanted[row]), as_text(plants[row]))


def _by_mask(frame: FrameData, plants: NDArray[np.int64], share: NDArray[np.float32]) -> Iterator[Wrong]:
    """(H, W, K) plants and shares: known, falling, within 1, and the mask's plant has the largest share, 0 the rest."""
    held = np.where(plants != 0, share, np.float32(0.0))
    total, most = held.sum(axis=-1), held.max(axis=-1)
    own = np.where(plants == frame.instance[..., None].astype(np.int64), held, 0).max(axis=-1)
    won: NDArray[np.float64] = np.where(frame.instance != 0, own, 1.0 - total)
    bounded = np.isfinite(held).all(axis=-1) & (held >= 0).all(axis=-1) & (total <= 1 + _TOLERANCE)
    falling = bounded & (np.diff(held, axis=-1) <= _TOLERANCE).all(axis=-1)
    for right, problem in (
        (np.all(plants >= 0, axis=-1), "an id is not in the manifest"),
        (falling, "shares do not fall within 0 to 1"),
        (won >= most - _TOLERANCE, "the mask's plant has not the largest share"),
    ):
        yield Wrong(~np.asarray(right, dtype=np.bool_), problem, frame.instance, plants[..., 0])


def _plants(ids: NDArray[np.uint32], plant_of: dict[int, int]) -> NDArray[np.int64]:
    """plant_id of each id; 0 of none, and -1 of one that no name has."""
    plants = np.zeros(ids.shape, dtype=np.int64)
    values, index = np.unique(ids[ids != 0], return_inverse=True)
    plants[ids != 0] = np.array([plant_of.get(value, -1) for value in values.tolist()], dtype=np.int64)[index]
    return plants


def standard_id(name: str) -> int:
    """Bits of the standard's float: MurmurHash3 of the name, its exponent kept from 0 and 255."""
    import mmh3

    bits = mmh3.hash(name, 0, False)
    return bits ^ (1 << 23) if (bits >> 23) & 0xFF in (0, 0xFF) else bits


def _manifests(header: dict[str, Any]) -> dict[str, dict[str, str]]:
    """Layer -> name -> id as hexadecimal digits."""
    found = {}
    for key, value in header.items():
        if key.startswith("cryptomatte/") and key.endswith("/name"):
            found[str(value)] = dict(load_json(header[key.removesuffix("name") + "manifest"]))
    return found


def _without_background(
    ids: NDArray[np.uint32], share: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """(B, K) ranks with 0 taken out, those behind it moved up."""
    # 0 has one rank at most, before those that nothing takes: what stands behind it moves up by one.
    behind = np.arange(ids.shape[-1]) >= np.argmax(ids == 0, axis=-1)[:, None]
    behind &= (ids == 0).any(axis=-1)[:, None]
    next_ids, next_share = (np.pad(ranks[:, 1:], ((0, 0), (0, 1))) for ranks in (ids, share))
    plants = np.where(behind, next_ids, ids).astype(np.int64)
    return plants, np.where(plants != 0, np.where(behind, next_share, share), np.float32(0.0))


FRAME_CHECKS = (cryptomatte,)
