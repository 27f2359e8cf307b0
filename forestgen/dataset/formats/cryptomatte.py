"""FRAME/cryptomatte.exr: who covers which share of each pixel, by name, for compositing programs and their like.

Cryptomatte 1.2: one single-part OpenEXR a frame, which all readers of the standard know. Three layers:

| layer         | names                                   | not in it: what its samples are then |
|---------------|-----------------------------------------|--------------------------------------|
| CryptoPlant   | species and plant_id, `poplar_0000123`  | sky and ground                       |
| CryptoSpecies | species                                 | sky and ground                       |
| CryptoPart    | parts, `trunk`, `leaf`, `ground`, ...   | sky                                  |

A layer's channels are `CryptoPlant00.R G B A` to `CryptoPlant03.R G B A`: id and coverage of rank 0, id and coverage
of rank 1, and so on to rank 7, by falling coverage. Equal coverages go by rising plant_id, by the recipe's order of
species, by the number of the part. All frames have the same number of ranks, as the standard wants.

**Coverage.** The share of the identity pass' samples, as in frame.exr. What the layer leaves out has no rank, as in the
standard, so a pixel's coverages sum to 1 less that. They sum to less still where a pixel holds more than eight ids: the
smallest coverages are then lost. Where the background covers as much as a plant, or more, the plant is rank 0 here but
does not win the pixel in the instance mask.

**Ids.** The standard's: MurmurHash3_32 (seed 0) of the name in UTF-8, with bit 23 flipped where the exponent of the
float of these bits would be 0 or 255. So an id is a normal number and never 0, which means nothing. Header attributes
``cryptomatte/KEY/`` name, hash, conversion and manifest: JSON, name -> id as 8 hexadecimal digits, of the plants in the
image, of all species and all parts. KEY is the first 7 digits of the layer name's own id.

**Names and plant_id.** The number after a name's last underscore is the plant_id. 32 bits are few: among 100,000 plants
one pair shares an id on average. The plant of the larger plant_id is then written with one more leading zero
(`poplar_00000123`), or as many as free its id. This is decided over all plants of the image, seen or not, so that its
frames agree. Species that share an id are refused; parts do not.

References
----------
Friedman and Jones, "Fully automatic ID mattes with support for motion blur and transparency", SIGGRAPH 2015 posters.
Psyop, "Cryptomatte specification", version 1.2.0: layer naming, metadata, ID generation.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import OutputError
from forestgen.core.parts import Part
from forestgen.dataset.exr import write_parts
from forestgen.dataset.formats.format import DatasetFormat
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.channels.channel import Layers
from forestgen.labels.labelled import LabelledFrame
from forestgen.labels.masks import coverage_ranks, rows_of

FILE_NAME = "cryptomatte.exr"
RANKS = 8
_PART_NAMES = tuple(part.name.lower() for part in Part if part is not Part.NOTHING)
_EXPONENT_BITS, _EXPONENT_SHIFT = np.uint32(0xFF), np.uint32(23)


@dataclass(frozen=True)
class CryptoLayer:
    """One layer of names."""

    name: str
    code: NDArray[np.integer]  # (H, W, RANKS) index into `names` + 1, by falling coverage; 0: nothing takes the rank
    coverage: NDArray[np.float32]  # (H, W, RANKS); 0 there
    names: Sequence[str]
    ids: NDArray[np.uint32]  # (names,) the bits of the standard's floats


class Cryptomatte(DatasetFormat):
    """Coverage by name, for compositing programs."""

    name = "cryptomatte"
    check_module = "forestgen.dataset.check.cryptomatte"
    bytes_per_pixel = 48 * 4

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's cryptomatte.exr into its folder; species that share an id raise `OutputError`."""
        write_cryptomatte(folder / FILE_NAME, labelled)


FORMAT = Cryptomatte()


def write_cryptomatte(path: Path, labelled: LabelledFrame) -> None:
    """Write a frame's layers; species that share an id raise `OutputError`."""
    channels: Layers = {}
    header: dict[str, str] = {}
    for layer in crypto_layers(labelled):
        channels |= _channels(layer)
        header |= _metadata(layer)
    write_parts(path, {"cryptomatte": channels}, header)


def crypto_layers(labelled: LabelledFrame) -> tuple[CryptoLayer, CryptoLayer, CryptoLayer]:
    """Plants, species and parts of a frame."""
    identity, population = labelled.frame.identity, labelled.population
    species_names = labelled.classes.species_names
    names = plant_names([species_names[k] for k in labelled.species], population.plant_id)
    plants, coverage = _ranks(identity.plant_id)
    seen = np.unique(plants[plants != 0])
    own_row = rows_of(seen, population.plant_id)
    code = np.where(plants == 0, 0, np.searchsorted(seen, plants) + 1)
    species_code = np.concatenate([[0], labelled.species + 1]).astype(np.uint32)
    row = np.searchsorted(population.plant_id, identity.plant_id) + 1  # every sample's plant is one of them, or 0
    row[identity.plant_id == 0] = 0
    return (
        CryptoLayer("CryptoPlant", code, coverage, *_named("CryptoPlant", [names[k] for k in own_row])),
        CryptoLayer("CryptoSpecies", *_ranks(species_code[row]), *_named("CryptoSpecies", species_names)),
        CryptoLayer("CryptoPart", *_ranks(identity.part.astype(np.uint32)), *_named("CryptoPart", _PART_NAMES)),
    )


def plant_names(species: Sequence[str], plant_id: NDArray[np.uint32]) -> list[str]:
    """(N,) names of a whole population's plants, ids sorted, whose hashes all differ; see the module."""
    names = [f"{name}_{number:07d}" for name, number in zip(species, plant_id.tolist(), strict=True)]
    ids = crypto_ids(names)
    order = np.argsort(ids, kind="stable")
    second = np.sort(order[1:][ids[order[1:]] == ids[order[:-1]]])
    if len(second):
        taken = set(ids.tolist())
        for row in second.tolist():
            digits = 8
            while (new := int(crypto_ids([f"{species[row]}_{plant_id[row]:0{digits}d}"])[0])) in taken:
                digits += 1
            taken.add(new)
            names[row] = f"{species[row]}_{plant_id[row]:0{digits}d}"
    return names


def crypto_ids(names: Sequence[str]) -> NDArray[np.uint32]:
    """(N,) uint32: bits of the float32 that the standard gives each name."""
    import mmh3

    bits = np.fromiter((mmh3.hash(name, 0, False) for name in names), dtype=np.uint32, count=len(names))
    exponent = (bits >> _EXPONENT_SHIFT) & _EXPONENT_BITS
    bits[(exponent == 0) | (exponent == _EXPONENT_BITS)] ^= np.uint32(1) << _EXPONENT_SHIFT
    return bits


def _named(layer: str, names: Sequence[str]) -> tuple[Sequence[str], NDArray[np.uint32]]:
    """Names and their ids, which must differ."""
    ids = crypto_ids(names)
    order = np.argsort(ids, kind="stable")
    same = np.flatnonzero(ids[order[1:]] == ids[order[:-1]])
    if len(same):
        first, second = names[order[same[0]]], names[order[same[0] + 1]]
        problem = f"Cryptomatte cannot tell {first!r} from {second!r}: their hashes are the same"
        hint = "rename one of them, or leave cryptomatte out of dataset.formats"
        raise OutputError(problem, where=layer, hint=hint)
    return names, ids


def _ranks(codes: NDArray[np.uint32]) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """(H, W, RANKS) codes and coverages of (H, W, S) samples, by falling coverage; 0 is left out."""
    ranks = coverage_ranks(codes, RANKS + 1)  # one more, for 0 may take one
    order = np.argsort(ranks.plant_id == 0, axis=-1, kind="stable")[..., :RANKS]
    ranked = np.take_along_axis(ranks.plant_id, order, axis=-1)
    coverage = np.take_along_axis(ranks.coverage, order, axis=-1)
    return ranked, np.where(ranked == 0, np.float32(0.0), coverage)


def _channels(layer: CryptoLayer) -> Layers:
    bits = np.concatenate([np.zeros(1, dtype=np.uint32), layer.ids])[layer.code]
    ids = bits.view(np.float32)
    channels: Layers = {}
    for rank in range(RANKS):
        level, (id_channel, coverage_channel) = f"{layer.name}{rank // 2:02d}", ("RG", "BA")[rank % 2]
        channels[f"{level}.{id_channel}"] = np.ascontiguousarray(ids[..., rank])
        channels[f"{level}.{coverage_channel}"] = np.ascontiguousarray(layer.coverage[..., rank])
    return channels


def _metadata(layer: CryptoLayer) -> Mapping[str, str]:
    key = f"cryptomatte/{int(crypto_ids([layer.name])[0]):08x}"[:-1]
    manifest = {name: f"{number:08x}" for name, number in zip(layer.names, layer.ids.tolist(), strict=True)}
    return {
        f"{key}/name": layer.name,
        f"{key}/hash": "MurmurHash3_32",
        f"{key}/conversion": "uint32_to_float32",
        f"{key}/manifest": json.dumps(manifest, ensure_ascii=False, separators=(",", ":")),
    }
