"""Pack a data set for a training program's own loader."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from forestgen.core.arguments import MOST_SEEDS, whole_of
from forestgen.core.errors import DatasetError, OutputError, RecipeError
from forestgen.core.figures import parse_bytes
from forestgen.core.progress import Progress
from forestgen.dataset.files import write_bytes, write_json
from forestgen.dataset.folder import OutputFolder
from forestgen.dataset.legend import FILE_NAME as CLASSES_FILE
from forestgen.dataset.pack import parquet_shards, tar_shards
from forestgen.dataset.pack.channels import Channel, choose_channels, read_file, read_json
from forestgen.dataset.pack.columns import columns_of
from forestgen.dataset.pack.readme import body, card_of, front_matter
from forestgen.dataset.pack.samples import Sample, Shard, in_order, measure, read_samples
from forestgen.dataset.pack.source import Source, open_source
from forestgen.dataset.safe_path import SafePath

Format = Literal["webdataset", "huggingface"]
FORMATS: tuple[Format, ...] = ("webdataset", "huggingface")
PACK_FILE = "pack.json"
_SCHEMA = "forestgen-pack/1"


@dataclass(frozen=True)
class Packing:
    """What to pack, and how."""

    format: Format
    shard_bytes: int = 500_000_000
    channels: tuple[str, ...] | None = None  # None: the usual ones that the data set has
    splits: tuple[str, ...] = ()  # those to pack; none: all
    seed: int | None = 0  # of the order of the frames; None: by name


def packing_of(
    form: str, shard_size: int | str, channels: Sequence[str] | None, splits: Sequence[str], seed: int | None
) -> Packing:
    """What to pack, from plain values.

    Parameters
    ----------
    shard_size : bytes, or a text such as 500MB.

    Raises
    ------
    RecipeError : no such format, size or seed.
    """
    if seed is not None:
        whole_of(seed, "seed", 0, MOST_SEEDS)
    chosen = next((one for one in FORMATS if one == form), None)
    if chosen is None:
        raise RecipeError("there is no such format", parameter="format", expected=" or ".join(FORMATS), got=form)
    names = None if channels is None else tuple(channels)
    return Packing(chosen, parse_bytes(shard_size, "shard_size"), names, tuple(splits), seed)


@dataclass(frozen=True)
class Packed:
    """What was packed."""

    folder: Path
    splits: Mapping[str, Sequence[Shard]]
    channels: tuple[str, ...]
    code: tuple[str, str]  # two lines of Python that open it


def pack(root: Path, target: Path, packing: Packing, *, overwrite: bool = False, progress: Progress) -> Packed:
    """Write a data set as shards of WebDataset or as a folder that Hugging Face's library opens.

    The folder `target` appears when everything in it is complete, or not at all, and has the same bytes whenever the
    same data set is packed in the same way. One frame is in memory at a time; of Parquet a group of rows.

    Raises
    ------
    DatasetError : a file of the data set is missing or damaged.
    RecipeError : the data set has no such channel or split.
    OutputError : the pack cannot be written.
    """
    source = open_source(root, packing.splits)
    _check_apart(root, target)
    folders = [split.folder / frame for split in source.splits for frame in split.frames]
    channels = choose_channels(folders, packing.channels)
    names = _split_names(source, packing.format)
    with progress.stage("looking", source.frames) as advance:
        needed = measure(source, channels, advance) + source.frames * _bytes_a_frame(packing.format, channels)
    with OutputFolder(target, overwrite=overwrite, required_bytes=needed, is_ours=is_pack) as folder:
        shards: dict[str, list[Shard]] = {}
        with progress.stage("packing", source.frames) as advance:
            for split in source.splits:
                samples = read_samples(source, split, in_order(split, packing.seed), channels, advance)
                shards[names[split.name]] = _write_split(folder, names[split.name], samples, source, channels, packing)
        _write_rest(folder, source, packing, channels, shards)
    names_packed = tuple(channel.name for channel in channels)
    return Packed(target, shards, names_packed, opening_code(packing.format, target, shards))


def is_pack(folder: Path) -> bool:
    """Whether a folder is a pack of ours: only such a folder may be replaced."""
    try:
        return str(read_json(SafePath(folder, PACK_FILE)).get("schema", "")).startswith("forestgen-pack/")
    except DatasetError:
        return False


def opening_code(form: Format, target: Path | str, shards: Mapping[str, Sequence[Shard]]) -> tuple[str, str]:
    """Two lines of Python that open the pack's first split."""
    split = "train" if "train" in shards else next(iter(shards))
    if form == "huggingface":
        return "import datasets", f'{split} = datasets.load_dataset("{target}", split="{split}")'
    names = f"{target}/{brace_notation(shards[split])}"
    decoder = 'handle_extension("png", lambda png: numpy.asarray(PIL.Image.open(io.BytesIO(png))))'
    return (
        "import io, numpy, PIL.Image, webdataset",
        f'{split} = webdataset.WebDataset("{names}", shardshuffle=False).decode(webdataset.{decoder})',
    )


def brace_notation(shards: Sequence[Shard]) -> str:
    """All shards in one name: train-{000000..000012}.tar."""
    first, last = shards[0].name, shards[-1].name
    if first == last:
        return first
    return re.sub(r"(\d{6})(?=\.tar$)", lambda digits: f"{{{digits[1]}..{last[-10:-4]}}}", first)


def _check_apart(root: Path, target: Path) -> None:
    try:
        inside = target.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError):
        return  # OutputFolder tells what is wrong with the path
    if inside:
        problem = "the pack would lie inside the data set"
        raise OutputError(problem, where=str(target), hint=f"choose a folder beside {root}")


def _split_names(source: Source, form: Format) -> dict[str, str]:
    """Split -> its name in the pack: Hugging Face's library takes no hyphens."""
    names = {split.name: split.name for split in source.splits}
    if form == "huggingface":
        names = {name: name.replace("-", "_") for name in names}
    if len(set(names.values())) < len(names):
        raise RecipeError(
            "two splits would have the same name, for hyphens become underscores",
            parameter="splits",
            got=", ".join(names),
            hint="pack them one by one",
        )
    return names


def _bytes_a_frame(form: Format, channels: Sequence[Channel]) -> int:
    return tar_shards.bytes_a_frame(channels) if form == "webdataset" else parquet_shards.BYTES_A_FRAME


def _write_split(
    folder: Path, name: str, samples: Iterator[Sample], source: Source, channels: Sequence[Channel], packing: Packing
) -> list[Shard]:
    if packing.format == "webdataset":
        return tar_shards.write_split(folder, name, samples, channels, source.classes, packing.shard_bytes)
    return parquet_shards.write_split(folder, name, samples, columns_of(source, channels), packing.shard_bytes)


def _write_rest(
    folder: Path,
    source: Source,
    packing: Packing,
    channels: Sequence[Channel],
    shards: Mapping[str, Sequence[Shard]],
) -> None:
    """classes.json, README.md, pack.json."""
    write_bytes(folder / CLASSES_FILE, read_file(source.splits[0].folder / CLASSES_FILE))
    code = opening_code(packing.format, "PATH", shards)
    of_card, chapter = card_of(source.root)
    title, names = "Packed for " + _LIBRARIES[packing.format], [channel.name for channel in channels]
    text = body(title, code, shards, source.classes, names) + chapter
    head = front_matter(columns_of(source, channels), shards, of_card) if packing.format == "huggingface" else ""
    write_bytes(folder / "README.md", (head + text).encode())
    content = {
        "schema": _SCHEMA,
        "format": packing.format,
        "channels": names,
        "order_seed": packing.seed,
        "shard_bytes": packing.shard_bytes,
        "splits": {name: [asdict(one) for one in listed] for name, listed in shards.items()},
    }
    write_json(folder / PACK_FILE, content)


_LIBRARIES = {"webdataset": "WebDataset", "huggingface": "Hugging Face's datasets"}
