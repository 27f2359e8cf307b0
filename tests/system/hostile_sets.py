"""Data sets as somebody would make them who means harm: changes of JSON, and of what lies in a folder."""

from __future__ import annotations

import hashlib
import json
import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

OUTSIDE, MARK = "outside", "SENTINEL-7391"

# A value of a JSON file, somewhere in it, becomes one of these.
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 10**39, 10**19, 1e99, 0.5, "", "x", [], {}, [[]], [None], {"x": None}, "\x1b[2J", "x" * 5000),
    *(f"../../{OUTSIDE}/secret.txt", "/etc/passwd", "..", "a/../../b", "\x00", "/dev/zero", [{}], {"0": []}, [1, 2, 3]),
    "²", "9" * 5000, json.loads("[" * 90 + "]" * 90),
)  # fmt: skip


def _in_front(text: bytes) -> Callable[[bytes], bytes]:
    return lambda content: text + content


# Or the whole file becomes something else.
WHOLES: dict[str, Callable[[bytes], bytes]] = {
    "nothing": lambda _: b"",
    "half of it": lambda content: content[: len(content) // 2],
    "no text": lambda content: content.replace(b"e", b"\xff"),
    "another encoding": lambda content: content.decode().encode("utf-16"),
    "brackets without end": lambda _: b"[" * 200_000,
    "deeply nested": lambda _: b'{"a":' * 50_000 + b"1" + b"}" * 50_000,
    "nested as deep as Python can": lambda _: b"[" * 900 + b"]" * 900,
    "not a number": lambda _: b'{"schema": NaN}',
    "infinity": lambda content: content.replace(b":1", b":1e999").replace(b": 1", b": 1e999"),
    "a number of many digits": lambda content: content.replace(b":1", b":1" + b"9" * 5000),
    "half a character": lambda content: content.replace(b'"', b'"\\ud800', 1),
    "a list": lambda _: b"[1, 2]",
    "a text": lambda _: b'"text"',
    "null": lambda _: b"null",
    "no keys": lambda _: b"{}",
    "zeros": lambda content: bytes(len(content)),
    "a mark": _in_front(b"\xef\xbb\xbf"),
}


def changed(content: bytes, rng: random.Random) -> bytes:
    """JSON with another value in one place, or without one of its keys, or with one more."""
    data = json.loads(content)
    places = list(_places(data))
    holder, key = rng.choice(places)
    kind = rng.random()
    if kind < 0.15 and isinstance(holder, dict):
        del holder[key]
    elif kind < 0.25 and isinstance(holder, dict):
        holder[str(rng.choice(("..", "x/y", "9" * 30, "")))] = rng.choice(VALUES)
    else:
        holder[key] = rng.choice(VALUES)
    return json.dumps(data).encode()


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            yield value, key
            yield from _places(value[key])


def summed(content: bytes) -> bytes:
    """A job's record with the sum of its content, whatever that is."""
    try:
        data = json.loads(content)
    except (ValueError, RecursionError):
        return content
    if not isinstance(data, dict):
        return content
    data.pop("sha256", None)
    body = json.dumps(data, separators=(",", ":"), ensure_ascii=False)[:-1].encode("utf-8", "surrogatepass")
    return body + b',"sha256":"' + hashlib.sha256(body).hexdigest().encode() + b'"}\n'


def outside(folder: Path) -> Path:
    """A folder beside the data set that no command may read or change."""
    secret = folder / OUTSIDE
    secret.mkdir()
    (secret / "secret.txt").write_text(MARK)
    return secret


def _linked(path: Path, secret: Path) -> None:
    """The file, as it was, lies outside, and a link leads there."""
    target = secret / f"own-{path.name}"
    path.rename(target)
    path.symlink_to(target)


def _linked_upwards(path: Path, secret: Path) -> None:
    target = secret / f"own-{path.name}"
    path.rename(target)
    path.symlink_to(os.path.relpath(target, path.parent))


def _replaced(make: Callable[[Path], object]) -> Callable[[Path, Path], None]:
    def change(path: Path, _: Path) -> None:
        if path.is_dir():
            path.rename(path.with_name(f"{path.name}-before"))
        else:
            path.unlink()
        make(path)

    return change


# What a file, or a folder, of the data set becomes.
WAYS: dict[str, Callable[[Path, Path], None]] = {
    "a link to outside": _linked,
    "a relative link to outside": _linked_upwards,
    "a link to itself": _replaced(lambda path: path.symlink_to(path.name)),
    "a pipe": _replaced(os.mkfifo),
    "a link to zeros": _replaced(lambda path: path.symlink_to("/dev/zero")),
    "a folder": _replaced(Path.mkdir),
    "a sparse file of a terabyte": _replaced(lambda path: _sparse(path, 2**40)),
}


def _sparse(path: Path, size: int) -> None:
    with path.open("wb") as stream:
        stream.truncate(size)
