"""Recipes and files as somebody would write them who means harm."""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from command_line import CAMERAS, TINY

SECRET = "outside"  # folder beside the recipe's, which no recipe may read
_COMMUNITY = "community: {model: multiset_lsystem, program: succession, steps: 12}"


def changed(old: str, new: str) -> str:
    """The tiny recipe with one text in place of another."""
    assert old in TINY, old
    return TINY.replace(old, new)


def _seed(text: str) -> str:
    return changed("seed: 3", text)


def _sky(text: str) -> str:
    return _seed(f"sky: {{clouds: {text}}}")


def _plant(text: str) -> str:
    return changed("{fireweed: }", f"{{poplar: {{from: poplar, plant: {text}}}}}")


def _program(text: str) -> str:
    return changed(
        _COMMUNITY, f"community: {{model: multiset_lsystem, program: {{name: x, text: {json.dumps(text)}}}}}"
    )


def _density(text: str) -> str:
    return changed(_COMMUNITY, f"community: {{model: uniform, plants: {{fireweed: {{count: 5, map: {text}}}}}}}")


# Where a recipe names a file: its text, and the ending of the file's name. PATH stands for the path, as YAML.
SLOTS: dict[str, tuple[str, str]] = {
    "species": (changed("{fireweed: }", "{fireweed: {from: PATH}}"), ".yaml"),
    "a plant's program": (changed("{fireweed: }", "{lily: {from: lily, plant: {program: PATH}}}"), ".lsys"),
    "a community's program": (changed("program: succession", "program: PATH"), ".lsys"),
    "spectrum": (
        changed("{fireweed: }", "{birch: {from: birch, materials: {leaf: {spectrum: PATH}}}}"),
        ".csv",
    ),
    "sensor": (changed("cameras: [{", "cameras: [{bands: PATH, "), ".csv"),
    "terrain": (changed("terrain: flat", "terrain: {kind: map, map: PATH}"), ".npy"),
    "density": (_density("PATH"), ".npy"),
    "density as a mapping": (_density("{file: PATH, scale: 2}"), ".npy"),
    "density by choice": (_density("{choice: [PATH, PATH]}"), ".npy"),
    "density drawn": (_density("{file: {choice: [PATH, PATH]}}"), ".npy"),
    "sounding": (_sky("{type: cumulus, sounding: {file: PATH}}"), ".csv"),
    "emission": (_sky("{type: cumulus, emission: {map: PATH}}"), ".npy"),
    "weather": (_sky("{type: file, file: PATH}"), ".vol"),
    "keep_out": (_density("[[1]]").replace("model: uniform, ", "model: uniform, keep_out: PATH, "), ".npy"),
}

# How a path leaves the recipe's folder: what is written, and what is made for it beside the recipe.
WAYS: dict[str, Callable[[Path, str], str]] = {
    "absolute": lambda folder, name: str(folder.parent / SECRET / name),
    "upwards": lambda folder, name: f"../{SECRET}/{name}",
    "upwards and round": lambda folder, name: f"./a/../../{SECRET}/./{name}",
    "by a link": lambda folder, name: _linked(folder, f"link{Path(name).suffix}", folder.parent / SECRET / name, ""),
    "by a linked folder": lambda folder, name: _linked(folder, "links", folder.parent / SECRET, f"/{name}"),
    "by a chain of links": lambda folder, name: _chained(folder, name),
}


def _linked(folder: Path, name: str, target: Path, rest: str) -> str:
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(target)
    return f"./{name}{rest}"


def _chained(folder: Path, name: str) -> str:
    _linked(folder, "second", Path("..") / SECRET, "")
    return _linked(folder, "first", Path("second"), f"/{name}")


# Paths that are refused by how they are written.
WRITTEN = (
    "~/secret", "~root/secret", "//server/share/secret", r"\\server\share\secret", r"C:\secret", "C:/secret",
    "file:///etc/passwd", "http://localhost:9/secret", "s3://bucket/secret", "/dev/zero", "/proc/self/environ", "",
    "a\tb", "a\nb",
)  # fmt: skip


def _laughs(width: int, depth: int) -> str:
    rows = [f"a0: &a0 [{', '.join(['x'] * width)}]"]
    rows += [f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * width)}]" for i in range(depth)]
    return "\n".join(rows) + "\n" + TINY


TEXTS: dict[str, str] = {
    "code by a tag": _seed("seed: !!python/object/apply:os.system [touch pwned]"),
    "a module by a tag": _seed("seed: !!python/module:os"),
    "a name by a tag": _seed("seed: !!python/name:os.system"),
    "a class by a tag": _seed("seed: !!python/object:forestgen.recipe.schema.Recipe {seed: 3}"),
    "a tag of one's own": _seed("dataset: !mine {description: x}"),
    "bytes": _seed("dataset: {description: !!binary aGVsbG8=}"),
    "a set": _seed("dataset: {formats: !!set {coco, yolo}}"),
    "pairs": _seed("dataset: !!omap [description: x]"),
    "a billion laughs": _laughs(20, 9),
    "a list in itself": "a: &a [*a]\n" + TINY,
    "a mapping in itself": "a: &a {b: *a}\n" + TINY,
    "a merge of itself": "a: &a {<<: *a}\n" + TINY,
    "a merge of no mapping": _seed("<<: [1, 2]"),
    "an alias of nothing": _seed("seed: *nothing"),
    "many brackets": "a: " + "[" * 200 + "]" * 200 + "\n" + TINY,
    "many braces": "a: " + "{b: " * 200 + "}" * 200 + "\n" + TINY,
    "a key twice": _seed("seed: 3\nseed: 4"),
    "two documents": TINY + "---\n" + TINY,
    "code by a directive": "%TAG ! tag:yaml.org,2002:python/\n---\n"
    + _seed("seed: !object/apply:os.system [touch pwned]"),
    "a large whole number": _seed("seed: " + "9" * 5000),
    "a large power": _seed("seed: 1e999999999"),
    "a long hexadecimal number": _seed("seed: 0x" + "f" * 50_000),
    "not a number": _seed("seed: .nan"),
    "infinity": _seed("sky: {turbidity: .inf}"),
    "a minus zero of images": _seed("images: -0.0"),
    "a long text": _seed(f"dataset: {{description: {'x' * 100_000}}}"),
    "a long key": _seed(f"{'x' * 1000}: 3"),
    "a key that steers the terminal": _seed('"\\e[2J\\e]0;pwned\\a": 3'),
    "a text that steers the terminal": _seed('dataset: {description: "\\e[2J"}'),
    "a text that is turned round": _seed('dataset: {contributor: "\\u202egnp.exe"}'),
    "half a character": _seed('dataset: {contributor: "\\ud800"}'),
    "a camera up": changed("cameras: [{", "cameras: [{name: ../../up, "),
    "a camera from the root": changed("cameras: [{", "cameras: [{name: /tmp/up, "),
    "a camera of two lines": changed("cameras: [{", 'cameras: [{name: "a\\nb", '),
    "a camera of nothing": changed("cameras: [{", 'cameras: [{name: "", '),
    "a species up": changed("{fireweed: }", "{../up: {from: fireweed}}"),
    "a species of HTML": changed("{fireweed: }", '{"<img src=x onerror=alert(1)>": {from: fireweed}}'),
    "a split up": _seed("dataset: {splits: {../up: 1}}"),
    "a class of two lines": changed("labels: {samples: 1}", 'labels: {samples: 1, classes: {"a\\nb": [fireweed]}}'),
    "a model by its path": changed("multiset_lsystem", "os:system"),
    "a generator by its path": _plant("{generator: 'os:system'}"),
    "images without end": _seed("images: 1000000000000000"),
    "an image far off": _seed("first_image: 1" + "0" * 18),
    "cameras without end": changed("cameras: [{", "cameras: [" + "{size_px: [8, 8]}, " * 1000 + "{"),
    "frames without end": changed("cameras: [{", "cameras: [{path: {position_m: [3, 9, 2], frames: 1000000000}, "),
    "an orbit without end": changed(CAMERAS, "cameras: [{rig: {kind: orbit, radius_m: 5, count: 1000000000}}]"),
    "pixels without end": changed("[48, 27]", "[1000000, 1000000]"),
    "samples without end": changed("samples: 1, denoise", "samples: 1000000000, denoise"),
    "identity samples without end": changed("labels: {samples: 1}", "labels: {samples: 1000000000000}"),
    "steps without end": changed("steps: 12", "steps: 1000000000000"),
    "a site without end": changed("[6, 5]", "[1.0e+9, 1.0e+9]"),
    "choices without end": _seed("sky: {turbidity: {choice: [" + ", ".join(f"t{k}" for k in range(1200)) + "]}}"),
    "distributions without end": changed(
        "cameras: [{", "cameras: [" + "{size_px: [8, 8], hfov_deg: {uniform: [40, 50]}}, " * 501 + "{"
    ),
    "species without end": changed("{fireweed: }", "{" + ", ".join(f"s{i}: stalk" for i in range(1001)) + "}"),
    "exemplars without end": changed("exemplars_per_species: 2", "exemplars_per_species: 1000000000"),
    "plants without end": changed(
        _COMMUNITY, "community: {model: uniform, plants: {fireweed: {count: 1000000000000}}}"
    ),
    "a grid without end": _density("[[1]]").replace("model: uniform", "model: uniform, cells: [9999999, 9999999]"),
    "clouds without end": _sky("{type: noise, extent_m: 1.0e+9}"),
    "air without end": _sky("{type: cumulus, domain: {extent_m: 100000, cell_m: 0.001}}"),
    "a tower of powers": _plant('{silhouette: {formula: "' + "9^" * 150 + "9" + '"}}'),
    "a call in a formula": _plant("{silhouette: {formula: \"__import__('os').system('touch pwned')\"}}"),
    "an attribute in a formula": _plant('{silhouette: {formula: "x.__class__.__bases__"}}'),
    "a formula of brackets": _plant('{silhouette: {formula: "' + "(" * 5000 + "x" + ")" * 5000 + '"}}'),
    "a long formula": _plant('{silhouette: {formula: "' + "x+" * 10_000 + 'x"}}'),
    "a formula that is a statement": _plant('{silhouette: {formula: "x if x() else lambda: 0"}}'),
    "a program of brackets": _program("lsystem: x\naxiom: A(" + "(" * 5000 + ")" * 5000 + ")\nendlsystem\n"),
    "a program of no end": _program("/* " + "x" * 100_000),
    "a program of nothing": _program(""),
    "a program that includes": _program('#include "/etc/passwd"\nlsystem: x\naxiom: A\nendlsystem\n'),
    "a spectrum of no table": changed(
        "{fireweed: }", "{birch: {from: birch, materials: {leaf: {spectrum: {name: x, text: 'root:x:0:0'}}}}}"
    ),
}


def png(width: int, height: int) -> bytes:
    """A PNG of few bytes that says it is so large."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    pixels = zlib.compress(bytes(1_000_000), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def tiff(width: int, height: int) -> bytes:
    """A TIFF of few bytes that says it is so large."""
    tags = ((256, width), (257, height), (258, 8), (259, 1), (262, 1), (273, 200), (277, 1), (278, height), (279, 16))
    rows = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + rows + bytes(200)


def npy(header: str) -> bytes:
    """An .npy file with this header and no values to speak of."""
    text = header.encode().ljust(118 - len(header) % 2) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(64)


def exr(path: Path, corner: int) -> None:
    """An OpenEXR file whose windows reach to a corner far away."""
    import OpenEXR

    pixels = {"Y": np.zeros((4, 4), np.float32)}
    with OpenEXR.File({"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}, pixels) as file:
        file.write(str(path))
    content = path.read_bytes()
    window = struct.pack("<4i", 0, 0, 3, 3)
    assert content.count(window) == 2
    path.write_bytes(content.replace(window, struct.pack("<4i", 0, 0, corner, corner)))


def pickled(path: Path) -> None:
    """An array of objects; loading it would run what they say."""

    class Harm:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, ("pwned",)

    np.save(path, np.array([[Harm(), 1]], dtype=object), allow_pickle=True)


def vol(cells: tuple[int, int, int]) -> bytes:
    """A grid volume of few bytes that says it has so many cells."""
    return struct.pack("<3sBi3ii6f", b"VOL", 3, 1, *cells, 1, 0, 0, 0, 1, 1, 1) + bytes(64)


def netcdf(path: Path, field: str, secret: Path) -> None:
    """A field of extinction whose values lie in another file, or are said to be very many."""
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["content"] = "forestgen clouds 1"
        for axis in "xyz":
            file.create_dataset(axis, data=np.arange(4.0))
        name, shape = "extinction_per_m", (4, 4, 4)
        if field == "link":
            file[name] = h5py.ExternalLink(str(secret), name)
        elif field == "soft link":
            file[name] = h5py.SoftLink("/nowhere")
        elif field == "external":
            file.create_dataset(name, shape, "f4", external=[(str(secret), 0, 256)])
        elif field == "virtual":
            layout = h5py.VirtualLayout(shape, "f4")
            layout[:] = h5py.VirtualSource(str(secret), name, shape)
            file.create_virtual_dataset(name, layout)
        elif field == "huge":
            file.create_dataset(name, (100_000, 100_000, 1000), "f4", chunks=(1, 1000, 1000), compression="gzip")
        file.attrs["low_m"], file.attrs["high_m"] = np.zeros(3), np.ones(3)
        file.attrs["phase"], file.attrs["albedo"] = np.array([0.8, -0.4, 0.9]), 1.0


def _bytes(content: bytes) -> Callable[[Path, Path], None]:
    return lambda path, _: path.write_bytes(content) and None


_ROWS = "".join(f"{400 + k / 1000},0.1\n" for k in range(30_000))
# Files that a recipe names, by the slot, each written by a function of its path and of a file outside.
FILES: dict[str, tuple[str, str, Callable[[Path, Path], None]]] = {
    "a PNG of four billion pixels": ("density", ".png", _bytes(png(65_535, 65_535))),
    "a PNG wider than can be": ("density", ".png", _bytes(png(2**31 - 1, 1))),
    "a TIFF of four billion pixels": ("density", ".tif", _bytes(tiff(65_535, 65_535))),
    "heights of four billion pixels": ("terrain", ".tif", _bytes(tiff(65_535, 65_535))),
    "an OpenEXR file to the horizon": ("density", ".exr", lambda path, _: exr(path, 2**30)),
    "an array of objects": ("density", ".npy", lambda path, _: pickled(path)),
    "an array of a trillion": (
        "density",
        ".npy",
        _bytes(npy("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000, 1000000), }")),
    ),
    "an array of negative shape": (
        "density",
        ".npy",
        _bytes(npy("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 5), }")),
    ),
    "an array with code in its header": (
        "density",
        ".npy",
        _bytes(npy("{'descr': __import__('os').system('touch pwned'), 'fortran_order': False, 'shape': (2, 2), }")),
    ),
    "a ZIP archive": ("density", ".npy", _bytes(b"PK\x03\x04" + bytes(100))),
    "a pipe": ("density", ".npy", lambda path, _: os.mkfifo(path)),
    "a species' file that is a pipe": ("species", ".yaml", lambda path, _: os.mkfifo(path)),
    "a folder": ("density", ".npy", lambda path, _: path.mkdir()),
    "a link to itself": ("density", ".npy", lambda path, _: path.symlink_to(path.name)),
    "a volume of a trillion cells": ("weather", ".vol", _bytes(vol((10_000, 10_000, 10_000)))),
    "a volume of overflowing cells": ("weather", ".vol", _bytes(vol((2**31 - 1, 2**31 - 1, 2**31 - 1)))),
    "a volume of negative cells": ("weather", ".vol", _bytes(vol((-4, -4, 1)))),
    **{
        f"a field by {field}": ("weather", ".nc", lambda path, secret, field=field: netcdf(path, field, secret))
        for field in ("link", "soft link", "external", "virtual", "huge")
    },
    "a sounding of many rows": ("sounding", ".csv", _bytes(b"height_m,temperature_c\n" + b"0,1\n" * 3_000_000)),
    "a spectrum of many rows": ("spectrum", ".csv", _bytes(f"wavelength_nm,reflectance\n{_ROWS}".encode())),
    "a spectrum of one long line": ("spectrum", ".csv", _bytes(b"wavelength_nm," + b"a," * 500_000)),
    "a program of many megabytes": ("a community's program", ".lsys", _bytes(b"lsystem: x\n" + b"// x\n" * 300_000)),
    "a species of many megabytes": ("species", ".yaml", _bytes(b"a: 1\n" * 300_000)),
    "a species with code": ("species", ".yaml", _bytes(b"plant: !!python/object/apply:os.system [touch pwned]\n")),
}
