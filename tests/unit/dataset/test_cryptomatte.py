from __future__ import annotations

import json
import shutil
import struct
import subprocess
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from dataset_shots import SETTINGS, make_shot

from forestgen.core.errors import OutputError
from forestgen.core.parts import Part
from forestgen.dataset.formats import cryptomatte
from forestgen.dataset.formats.cryptomatte import crypto_ids, plant_names, write_cryptomatte
from forestgen.recipe.classes import ClassMap
from support.error_messages import raises_error

# MurmurHash3_x86_32 of seed 0 (Wikipedia's test cases), and the floats of the reference decoder's own tests.
MURMUR3_32 = {
    b"": 0,
    b"test": 0xBA6BD213,
    b"Hello, world!": 0xC0363E43,
    b"The quick brown fox jumps over the lazy dog": 0x2E4FF723,
}
FLOATS = {
    "hello": 6.0705627102400005616e-17,
    "cube": -4.08461912519e15,
    "sphere": 2.79018604383e15,
    "plane": 3.66557617593e-11,
    "равнина": -1.3192631212399999468e-25,
    "mädchen": 6.2361298211599995797e25,
}


def plant_id_of(name):
    return int(name.rpartition("_")[2])


def murmur3(key):
    """MurmurHash3_x86_32, seed 0, from its description."""

    def turn(value, by):
        return ((value << by) | (value >> (32 - by))) & 0xFFFFFFFF

    state = 0
    padded = key + bytes(-len(key) % 4)
    for start in range(0, len(padded), 4):
        word = int.from_bytes(padded[start : start + 4], "little") * 0xCC9E2D51 & 0xFFFFFFFF
        state ^= turn(word, 15) * 0x1B873593 & 0xFFFFFFFF
        if start + 4 <= len(key):
            state = (turn(state, 13) * 5 + 0xE6546B64) & 0xFFFFFFFF
    state ^= len(key)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35), (16, 1)):
        state = (state ^ (state >> shift)) * factor & 0xFFFFFFFF
    return state


def as_float(bits):
    """The standard's uint32_to_float32: the exponent is clamped to 1 to 254."""
    exponent = min(max((bits >> 23) & 0xFF, 1), 254)
    return struct.unpack("<f", struct.pack("<I", (bits & 0x807FFFFF) | (exponent << 23)))[0]


class Decoder:
    """Reads a layer by the specification alone: no line of forestgen's."""

    def __init__(self, path, layer):
        part = OpenEXR.File(str(path), separate_channels=True).parts[0]
        keys = {name.split("/")[1] for name in part.header if name.startswith("cryptomatte/")}
        data = {key: {n.split("/")[2]: v for n, v in part.header.items() if n.split("/")[1:2] == [key]} for key in keys}
        (self.key,) = [key for key in keys if data[key]["name"] == layer]
        self.data = data[self.key]
        self.manifest = json.loads(self.data["manifest"])
        levels = sorted({n.split(".")[0] for n in part.channels if n.split(".")[0][:-2] == layer})
        assert levels == [f"{layer}{i:02d}" for i in range(len(levels))]
        pixels = {name: channel.pixels for name, channel in part.channels.items()}
        assert all(values.dtype == np.float32 for values in pixels.values())
        self.ids = np.stack([pixels[f"{level}.{c}"] for level in levels for c in "RB"], axis=-1)
        self.coverage = np.stack([pixels[f"{level}.{c}"] for level in levels for c in "GA"], axis=-1)

    def mask(self, name):
        """Coverage of a name: the sum over all ranks of its id."""
        value = np.float32(as_float(murmur3(name.encode())))
        assert self.manifest[name] == struct.pack(">f", value).hex()
        return np.where(self.ids == value, self.coverage, 0.0).sum(axis=-1)


def decoded(path, shot, layer="CryptoPlant"):
    write_cryptomatte(path, shot.labelled)
    return Decoder(path, layer)


def test_murmur3_and_the_float_are_the_standards():
    for key, value in MURMUR3_32.items():
        assert murmur3(key) == value
    assert [f"{bits:08x}" for bits in crypto_ids(["bunny", "default"])] == ["13851a76", "42c9679f"]  # specification
    for name, value in FLOATS.items():
        assert (
            crypto_ids([name]).view(np.float32)[0] == np.float32(value) == np.float32(as_float(murmur3(name.encode())))
        )


def test_no_id_is_zero_infinite_or_subnormal():
    names = [f"oak_{i}" for i in range(20_000)]
    bits = crypto_ids(names)
    raw = [murmur3(name.encode()) for name in names]
    odd = [i for i, value in enumerate(raw) if (value >> 23) & 0xFF in (0, 255)]
    assert len(odd) > 50
    assert [struct.pack("<f", as_float(raw[i])) for i in odd] == [int(bits[i]).to_bytes(4, "little") for i in odd]
    floats = bits.view(np.float32)
    assert np.isfinite(floats).all()
    assert np.abs(floats).min() >= np.finfo(np.float32).smallest_normal


@pytest.mark.parametrize("kind", ["shot", "wide_shot"])
def test_plants_decode_to_their_coverage_and_to_the_instance_mask(tmp_path, request, kind):
    shot = request.getfixturevalue(kind)
    samples, population = shot.frame.identity.plant_id, shot.population
    crypto = decoded(tmp_path / "a.exr", shot)
    names = {plant_id_of(name): name for name in crypto.manifest}
    assert set(names) == set(np.unique(samples).tolist()) - {0}
    total = np.zeros(samples.shape[:2])
    for plant, name in names.items():
        row = np.searchsorted(population.plant_id, plant)
        assert name == f"{population.species_names[population.species[row]]}_{plant:07d}"
        share = (samples == plant).mean(axis=2)
        np.testing.assert_array_equal(crypto.mask(name), share)
        total += share
    np.testing.assert_allclose(crypto.coverage.sum(axis=-1), total, atol=1e-6)
    assert (np.diff(crypto.coverage, axis=-1) <= 0).all()
    np.testing.assert_array_equal(crypto.ids == 0, crypto.coverage == 0)

    # Rank 0 wins the pixel where it covers more than the background does; ties among plants go to the smaller id.
    by_float = {struct.unpack(">f", bytes.fromhex(crypto.manifest[name]))[0]: plant for plant, name in names.items()}
    first = np.vectorize(lambda value: by_float.get(float(value), 0), otypes=[np.uint32])(crypto.ids[..., 0])
    mask = np.where(crypto.coverage[..., 0] > 1 - total, first, 0)
    np.testing.assert_array_equal(mask, shot.labelled.pixels.instance)
    assert (mask != first).any()


def test_species_and_parts(tmp_path, shot):
    identity, population = shot.frame.identity, shot.population
    species = decoded(tmp_path / "a.exr", shot, "CryptoSpecies")
    assert list(species.manifest) == ["poplar", "spruce", "oak"]
    for number, name in enumerate(population.species_names):
        plants = population.plant_id[population.species == number]
        np.testing.assert_array_equal(species.mask(name), np.isin(identity.plant_id, plants).mean(axis=2))
    parts = Decoder(tmp_path / "a.exr", "CryptoPart")
    assert len(parts.manifest) == len(Part) - 1
    for part in (Part.GROUND, Part.LEAF, Part.TRUNK):
        np.testing.assert_array_equal(parts.mask(part.name.lower()), (identity.part == part).mean(axis=2))
    assert parts.data["hash"] == "MurmurHash3_32"
    assert parts.data["conversion"] == "uint32_to_float32"
    assert parts.key == struct.pack(">f", as_float(murmur3(b"CryptoPart"))).hex()[:7]
    assert all(len(f"cryptomatte/{parts.key}/{field}") <= 31 for field in parts.data)  # what old readers take


def test_a_pixel_of_more_ids_than_ranks_loses_the_smallest(tmp_path):
    shot = make_shot(range(1, 13))
    samples = shot.frame.identity.plant_id.copy()
    many = np.repeat(np.arange(1, 12), [5, 4, 1, 1, 1, 1, 1, 1, 1, 1, 1])
    samples = np.concatenate([samples, np.zeros((*samples.shape[:2], len(many) - samples.shape[2]), np.uint32)], axis=2)
    samples[3, 5] = many
    frame = replace(shot.frame, identity=replace(shot.frame.identity, plant_id=samples))
    write_cryptomatte(tmp_path / "a.exr", replace(shot.labelled, frame=frame))
    crypto = Decoder(tmp_path / "a.exr", "CryptoPlant")
    assert [round(value * len(many)) for value in crypto.coverage[3, 5]] == [5, 4, 1, 1, 1, 1, 1, 1]
    assert crypto.coverage[3, 5].sum() == pytest.approx(15 / 18)
    kept = [crypto.mask(name)[3, 5] > 0 for name in sorted(crypto.manifest, key=plant_id_of)]
    assert kept[:11] == [True] * 8 + [False] * 3  # of equal coverages the smaller plant_ids


def test_names_of_a_whole_forest_have_ids_of_their_own():
    plant_id = np.arange(1, 200_001, dtype=np.uint32)
    species = ["poplar", "oak"] * 100_000
    names = plant_names(species, plant_id)
    assert [plant_id_of(name) for name in names] == plant_id.tolist()
    assert len(np.unique(crypto_ids(names))) == len(names)
    plain = [f"{name}_{plant:07d}" for name, plant in zip(species, plant_id.tolist(), strict=True)]
    _, first = np.unique(crypto_ids(plain), return_index=True)
    second = sorted(set(range(len(plain))) - set(first.tolist()))
    assert second  # 32 bits are too few for 200,000 names
    assert [i for i in range(len(names)) if names[i] != plain[i]] == second
    assert all(names[i] == plain[i].replace("_", "_0") for i in second)


def test_large_plant_ids_that_collide_are_told_apart(monkeypatch):
    honest = cryptomatte.crypto_ids
    plain = ["oak_0000001", "oak_4294967294", "oak_4294967295"]
    same = {"oak_4294967294", "oak_4294967295", "oak_04294967294"}  # and one leading zero does not help

    def colliding(names):
        return np.where([name in same for name in names], np.uint32(0x3F800000), honest(names)).astype(np.uint32)

    monkeypatch.setattr(cryptomatte, "crypto_ids", colliding)
    same.add("oak_04294967295")
    names = plant_names(["oak"] * 3, np.array([1, 2**32 - 2, 2**32 - 1], np.uint32))
    assert names == [*plain[:2], "oak_004294967295"]


def test_species_that_share_an_id_are_refused(tmp_path, shot, monkeypatch):
    monkeypatch.setattr(cryptomatte, "crypto_ids", lambda names: np.arange(len(names), dtype=np.uint32) // 2 + 1)
    with raises_error(OutputError, place="CryptoSpecies"):
        cryptomatte._named("CryptoSpecies", ClassMap(("poplar", "spruce", "oak")).species_names)


def test_sky_alone(tmp_path):
    crypto = decoded(tmp_path / "a.exr", make_shot([9]))  # the only plant is unseen
    assert crypto.manifest == {}
    assert not crypto.ids.any()
    assert not crypto.coverage.any()


def test_the_format_writes_the_same_bytes_each_time(tmp_path, shot):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        cryptomatte.FORMAT.write_frame(tmp_path / name, shot.labelled, SETTINGS)
    cryptomatte.FORMAT.merge(tmp_path, [tmp_path / "a", tmp_path / "b"], SETTINGS)
    assert (tmp_path / "a" / "cryptomatte.exr").read_bytes() == (tmp_path / "b" / "cryptomatte.exr").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}


def test_a_decoder_of_others_agrees(tmp_path, shot):
    """uv run --with cryptomatte-api pytest ... runs it."""
    api = pytest.importorskip("cryptomatte_api", reason="cryptomatte-api is not installed")
    write_cryptomatte(tmp_path / "a.exr", shot.labelled)
    for layer in api.Cryptomatte.load(str(tmp_path / "a.exr")):
        ours = Decoder(tmp_path / "a.exr", layer.metadata().name())
        masks = layer.masks()
        assert len(masks) >= 2
        for name, mask in masks.items():
            np.testing.assert_allclose(mask, ours.mask(name), atol=1e-6)


@pytest.mark.parametrize("tool", ["exrheader", "exrinfo"])
def test_openexrs_own_tools_read_it(tmp_path, shot, tool):
    program = shutil.which(tool)
    if program is None:
        pytest.skip(f"{tool} is not installed (Debian: openexr)")
    write_cryptomatte(tmp_path / "a.exr", shot.labelled)
    told = subprocess.run([program, str(tmp_path / "a.exr")], capture_output=True, text=True, check=True).stdout
    assert "CryptoPlant00.R" in told
