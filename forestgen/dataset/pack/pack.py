"""Pack a data set for a training program's own loader: what a form of packs is, the work, and the pack's README."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from forestgen.core.arguments import MOST_SEEDS, whole_of
from forestgen.core.errors import DatasetError, ForestgenError, OutputError, RecipeError
from forestgen.core.figures import parse_bytes
from forestgen.core.progress import Progress
from forestgen.dataset.card import markdown_template
from forestgen.dataset.files import write_bytes, write_json
from forestgen.dataset.folder import OutputFolder
from forestgen.dataset.pack.source import (
    Channel,
    Sample,
    Source,
    choose_channels,
    in_order,
    measure_frame,
    open_source,
    read_samples,
)
from forestgen.dataset.png import LEGEND_NAME
from forestgen.dataset.safe_path import SafePath, read_object, reading
from forestgen.recipe.registries import PACKS
from forestgen.recipe.sources import parse_yaml

README_TEMPLATE = Path(__file__).with_name("readme.md.jinja")  # what people read, of the pack's channels alone
_PACK_FILE = "pack.json"
_SCHEMA = "forestgen-pack/1"


@dataclass(frozen=True)
class Shard:
    """A file of a pack."""

    name: str
    frames: int
    size_bytes: int


@dataclass(frozen=True)
class Contents:
    """What goes into a pack."""

    source: Source
    channels: Sequence[Channel]
    shard_bytes: int  # no shard is larger, unless it holds one frame alone


class Pack:
    """A form of packs, without a state: one file in this folder, one line in recipe/registries.py."""

    title: str  # of the loader, for people
    frame_bytes: int  # upper estimate of what a frame takes on the disk beside its channels
    channel_bytes: int = 0  # and beside each channel's own bytes

    def split_name(self, name: str) -> str:
        """A split's name in the pack."""
        return name

    def write_split(self, folder: Path, split: str, samples: Iterator[Sample], contents: Contents) -> list[Shard]:
        """Write a split's shards into the pack's folder; `split` is its name in the pack."""
        raise NotImplementedError

    def opening_code(self, target: str, split: str, shards: Sequence[Shard]) -> tuple[str, str]:
        """Two lines of Python that open a split of the pack at `target`."""
        raise NotImplementedError

    def front_matter(
        self, contents: Contents, splits: Mapping[str, Sequence[Shard]], of_card: Mapping[str, Any]
    ) -> str:
        """What README.md begins with, before what people read; `of_card` is the same of the data set's card."""
        return ""


@dataclass(frozen=True)
class Packed:
    """What was packed."""

    folder: Path
    splits: Mapping[str, Sequence[Shard]]
    channels: tuple[str, ...]
    code: tuple[str, str]  # two lines of Python that open it


def pack(
    root: Path, target: Path, name: str, *, shard_size: int | str = 500_000_000, channels: Sequence[str] | None = None,
    splits: Sequence[str] = (), seed: int | None = 0, overwrite: bool = False, progress: Progress,
) -> Packed:  # fmt: skip
    """Write a data set as a training program's own loader reads it.

    The folder `target` appears when everything in it is complete, or not at all, and has the same bytes whenever the
    same data set is packed in the same way. One frame is in memory at a time; of Parquet a group of rows.

    Parameters
    ----------
    name : of a pack in the registry.
    shard_size : bytes, or a text such as 500MB.
    channels : None: the usual ones that the data set has.
    splits : those to pack; none: all.
    seed : of the order of the frames; None: by name.

    Raises
    ------
    DatasetError : a file of the data set is missing or damaged.
    RecipeError : there is no such format, size or seed, or the data set has no such channel or split.
    OutputError : the pack cannot be written.
    """
    if seed is not None:
        whole_of(seed, "seed", 0, MOST_SEEDS)
    PACKS.check(name, parameter="format")
    form: Pack = PACKS.load(name)
    shard_bytes = parse_bytes(shard_size, "shard_size")
    source = open_source(root, splits)
    _check_apart(root, target)
    folders = source.folders
    chosen = choose_channels(folders, channels)
    contents = Contents(source, chosen, shard_bytes)
    names = {split.name: form.split_name(split.name) for split in source.splits}
    if len(set(names.values())) < len(names):
        problem, hint = "two splits would have the same name, for hyphens become underscores", "pack them one by one"
        raise RecipeError(problem, parameter="splits", got=", ".join(names), hint=hint)
    needed = len(folders) * (form.frame_bytes + len(chosen) * form.channel_bytes)
    with progress.stage("looking", len(folders)) as advance:
        for frame in folders:
            needed += measure_frame(frame, chosen, source.pixels(frame))
            advance(1)
    with OutputFolder(target, overwrite=overwrite, required_bytes=needed, is_ours=is_pack) as folder:
        shards: dict[str, list[Shard]] = {}
        with progress.stage("packing", len(folders)) as advance:
            for split in source.splits:
                samples = read_samples(source, split, in_order(split, seed), chosen, advance)
                shards[names[split.name]] = form.write_split(folder, names[split.name], samples, contents)
        _write_rest(folder, form, contents, shards, {"format": name, "order_seed": seed})
    return Packed(target, shards, tuple(one.name for one in chosen), _opening_code(form, target, shards))


def is_pack(folder: Path) -> bool:
    """Whether a folder is a pack of ours: only such a folder may be replaced."""
    try:
        return str(read_object(SafePath(folder, _PACK_FILE)).get("schema", "")).startswith("forestgen-pack/")
    except DatasetError:
        return False


def _opening_code(form: Pack, target: Path | str, shards: Mapping[str, Sequence[Shard]]) -> tuple[str, str]:
    """Two lines of Python that open the pack's first split."""
    split = "train" if "train" in shards else next(iter(shards))
    return form.opening_code(str(target), split, shards[split])


def _check_apart(root: Path, target: Path) -> None:
    with suppress(OSError, RuntimeError):  # OutputFolder reports what is wrong with the path
        if target.resolve().is_relative_to(root.resolve()):
            problem = "the pack would lie inside the data set"
            raise OutputError(problem, where=str(target), hint=f"choose a folder beside {root}")


def _write_rest(
    folder: Path, form: Pack, contents: Contents, shards: Mapping[str, Sequence[Shard]], asked: Mapping[str, Any]
) -> None:
    """classes.json, README.md, pack.json."""
    source, names = contents.source, [channel.name for channel in contents.channels]
    with reading(source.splits[0].folder / LEGEND_NAME) as legend:
        write_bytes(folder / LEGEND_NAME, legend.read())
    of_card, chapter = _card_of(source.root)
    code = _opening_code(form, "PATH", shards)
    about = {"title": form.title, "code": code, "splits": shards, "classes": source.classes, "channels": names}
    text = str(markdown_template(README_TEMPLATE).render(about)) + chapter
    write_bytes(folder / "README.md", (form.front_matter(contents, shards, of_card) + text).encode())
    content = {
        "schema": _SCHEMA,
        **asked,
        "channels": names,
        "shard_bytes": contents.shard_bytes,
        "splits": {name: [asdict(one) for one in listed] for name, listed in shards.items()},
    }
    write_json(folder / _PACK_FILE, content)


def _card_of(root: Path) -> tuple[dict[str, Any], str]:
    """The data set's own README.md: its front matter, and its text as a chapter; empty where there is none."""
    try:
        text = SafePath(root, "README.md").read().decode("utf-8")
    except (OSError, UnicodeDecodeError):
        return {}, ""
    head = ""
    if text.startswith("---\n"):
        head, _, text = text.removeprefix("---\n").partition("\n---\n")
    try:
        content, _ = parse_yaml(head, "README.md", lines=False)
    except ForestgenError:
        content = None  # people have made something else of it
    chapter = "\n## The data set that was packed\n\n" + _lower_headings(text.strip()) + "\n"
    return content if isinstance(content, dict) else {}, chapter


def _lower_headings(text: str) -> str:
    """Headings two levels down; lines in fences are left alone."""
    lines, fenced = [], False
    for line in text.split("\n"):
        fenced ^= line.startswith("```")
        lines.append(f"##{line}" if line.startswith("#") and not fenced else line)
    return "\n".join(lines)
