"""README.md of a pack: how it is opened, what is in it, and the data set's own card."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from forestgen.core.errors import ForestgenError
from forestgen.dataset.card import markdown
from forestgen.dataset.pack.samples import Shard
from forestgen.dataset.safe_path import SafePath
from forestgen.recipe.sources import parse_yaml


def body(
    title: str,
    code: Sequence[str],
    splits: Mapping[str, Sequence[Shard]],
    classes: Mapping[str, Any],
    channels: Collection[str],
) -> str:
    """What people read.

    Parameters
    ----------
    code : lines that open the pack.
    channels : names of those that it holds; others are not told of.
    """
    rows = [
        f"| {name} | {sum(one.frames for one in shards):,} | {len(shards):,} | "
        f"{sum(one.size_bytes for one in shards):,} |"
        for name, shards in splits.items()
    ]
    semantic, categories = (
        ", ".join(f"{number} {markdown(name)}" for number, name in classes[key].items())
        for key in ("semantic", "categories")
    )
    told = (
        ("semantic", f"- `semantic`, classes: {semantic}"),
        ("instance", "- `instance`: plant_id = R + 256 G + 65536 B; 0 is no plant"),
        ("annotations", f"- Categories of the plants: {categories}"),
        ("depth", "- `depth`: steps of `depth_unit_m` along the camera's axis; 0 is sky, 65535 is beyond the range"),
    )
    lines = [
        f"# {title}",
        "",
        "```python",
        *code,
        "```",
        "",
        "| split | frames | files | bytes |",
        "|---|---|---|---|",
        *rows,
        "",
        *(text for channel, text in told if channel in channels),
        "",
    ]
    return "\n".join(lines)


def card_of(root: Path) -> tuple[dict[str, Any], str]:
    """The data set's own README.md: its front matter, and its text as a chapter; empty where there is none."""
    try:
        text = SafePath(root, "README.md").read().decode("utf-8")
    except (OSError, UnicodeDecodeError):
        return {}, ""
    head = ""
    if text.startswith("---\n"):
        head, _, text = text.removeprefix("---\n").partition("\n---\n")
    return _plain(head), "\n## The data set that was packed\n\n" + _lower_headings(text.strip()) + "\n"


def _plain(head: str) -> dict[str, Any]:
    """Front matter; nothing where people have made something else of it."""
    try:
        content, _ = parse_yaml(head, "README.md", lines=False)
    except ForestgenError:
        return {}
    return content if isinstance(content, dict) else {}


def _lower_headings(text: str) -> str:
    """Headings two levels down; lines in fences are left alone."""
    lines, fenced = [], False
    for line in text.split("\n"):
        fenced ^= line.startswith("```")
        lines.append(f"##{line}" if line.startswith("#") and not fenced else line)
    return "\n".join(lines)
