"""Pack a data set for a training program's own loader."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from forestgen.core.arguments import MOST_SEEDS, whole_of
from forestgen.core.errors import DatasetError, OutputError, RecipeError
from forestgen.core.figures import parse_bytes
from forestgen.core.progress import Progress
from forestgen.dataset.files import write_bytes, write_json
from forestgen.dataset.folder import OutputFolder
from forestgen.dataset.legend import FILE_NAME as CLASSES_FILE
from forestgen.dataset.pack.channels import choose_channels, read_file, read_json
from forestgen.dataset.pack.pack import Contents, Pack
from forestgen.dataset.pack.readme import body, card_of
from forestgen.dataset.pack.samples import Shard, in_order, measure, read_samples
from forestgen.dataset.pack.source import Source, open_source
from forestgen.dataset.safe_path import SafePath
from forestgen.recipe.registries import PACKS

PACK_FILE = "pack.json"
_SCHEMA = "forestgen-pack/1"


@dataclass(frozen=True)
class Packing:
    """What to pack, and how."""

    format: str  # name of a pack in the registry
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
    PACKS.check(form, parameter="format")
    names = None if channels is None else tuple(channels)
    return Packing(form, parse_bytes(shard_size, "shard_size"), names, tuple(splits), seed)


@dataclass(frozen=True)
class Packed:
    """What was packed."""

    folder: Path
    splits: Mapping[str, Sequence[Shard]]
    channels: tuple[str, ...]
    code: tuple[str, str]  # two lines of Python that open it


def pack(root: Path, target: Path, packing: Packing, *, overwrite: bool = False, progress: Progress) -> Packed:
    """Write a data set as a training program's own loader reads it.

    The folder `target` appears when everything in it is complete, or not at all, and has the same bytes whenever the
    same data set is packed in the same way. One frame is in memory at a time; of Parquet a group of rows.

    Raises
    ------
    DatasetError : a file of the data set is missing or damaged.
    RecipeError : the data set has no such channel or split.
    OutputError : the pack cannot be written.
    """
    form: Pack = PACKS.load(packing.format)
    source = open_source(root, packing.splits)
    _check_apart(root, target)
    folders = [split.folder / frame for split in source.splits for frame in split.frames]
    channels = choose_channels(folders, packing.channels)
    names, contents = _split_names(source, form), Contents(source, channels, packing.shard_bytes)
    frame_bytes = form.frame_bytes + len(channels) * form.channel_bytes
    with progress.stage("looking", source.frames) as advance:
        needed = measure(source, channels, advance) + source.frames * frame_bytes
    with OutputFolder(target, overwrite=overwrite, required_bytes=needed, is_ours=is_pack) as folder:
        shards: dict[str, list[Shard]] = {}
        with progress.stage("packing", source.frames) as advance:
            for split in source.splits:
                samples = read_samples(source, split, in_order(split, packing.seed), channels, advance)
                shards[names[split.name]] = form.write_split(folder, names[split.name], samples, contents)
        _write_rest(folder, form, contents, packing, shards)
    names_packed = tuple(channel.name for channel in channels)
    return Packed(target, shards, names_packed, _opening_code(form, target, shards))


def is_pack(folder: Path) -> bool:
    """Whether a folder is a pack of ours: only such a folder may be replaced."""
    try:
        return str(read_json(SafePath(folder, PACK_FILE)).get("schema", "")).startswith("forestgen-pack/")
    except DatasetError:
        return False


def _opening_code(form: Pack, target: Path | str, shards: Mapping[str, Sequence[Shard]]) -> tuple[str, str]:
    """Two lines of Python that open the pack's first split."""
    split = "train" if "train" in shards else next(iter(shards))
    return form.opening_code(str(target), split, shards[split])


def _check_apart(root: Path, target: Path) -> None:
    try:
        inside = target.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError):
        return  # OutputFolder tells what is wrong with the path
    if inside:
        problem = "the pack would lie inside the data set"
        raise OutputError(problem, where=str(target), hint=f"choose a folder beside {root}")


def _split_names(source: Source, form: Pack) -> dict[str, str]:
    """Split -> its name in the pack."""
    names = {split.name: form.split_name(split.name) for split in source.splits}
    if len(set(names.values())) < len(names):
        raise RecipeError(
            "two splits would have the same name, for hyphens become underscores",
            parameter="splits",
            got=", ".join(names),
            hint="pack them one by one",
        )
    return names


def _write_rest(
    folder: Path, form: Pack, contents: Contents, packing: Packing, shards: Mapping[str, Sequence[Shard]]
) -> None:
    """classes.json, README.md, pack.json."""
    source, names = contents.source, [channel.name for channel in contents.channels]
    write_bytes(folder / CLASSES_FILE, read_file(source.splits[0].folder / CLASSES_FILE))
    of_card, chapter = card_of(source.root)
    code = _opening_code(form, "PATH", shards)
    text = body(f"Packed for {form.title}", code, shards, source.classes, names) + chapter
    write_bytes(folder / "README.md", (form.front_matter(contents, shards, of_card) + text).encode())
    content = {
        "schema": _SCHEMA,
        "format": packing.format,
        "channels": names,
        "order_seed": packing.seed,
        "shard_bytes": packing.shard_bytes,
        "splits": {name: [asdict(one) for one in listed] for name, listed in shards.items()},
    }
    write_json(folder / PACK_FILE, content)
