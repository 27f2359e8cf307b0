"""Files that other tools leave in a data set's folder: they are no part of it, and no damage.

A pattern matches the name of a file, or of a folder with all that is in it. A file that `SHA256SUMS` lists belongs to
the data set, whatever its name.
"""

from __future__ import annotations

from fnmatch import fnmatchcase

_TOOLS: dict[str, tuple[str, ...]] = {
    "Ultralytics": ("*.cache",),  # what it has read of the labels
    "Hugging Face": (".cache", ".huggingface"),
    "FiftyOne": (".fiftyone*", "fiftyone.yml"),
    "macOS": (".DS_Store", "._*"),
    "Windows": ("Thumbs.db", "desktop.ini"),
    "a Linux desktop": (".directory", ".Trash-*"),
    "Jupyter": (".ipynb_checkpoints",),
    "Python": ("__pycache__",),
    "Git": (".git*",),
    "DVC": (".dvc*", "*.dvc"),
    "a network file system": (".nfs*",),  # files that were removed while in use
    "an editor": ("*~", ".*.swp", ".*.swo", ".#*", "#*#", ".idea", ".vscode"),
}
# Names before patterns: ".cache" is a folder of Hugging Face's.
_PATTERNS = sorted(
    ((one, tool) for tool, several in _TOOLS.items() for one in several), key=lambda pair: "*" in pair[0]
)


def tool_of(path: str) -> str | None:
    """The tool that makes files of this path below the data set's folder; None if forestgen knows none."""
    return next((tool for name in path.split("/") for pattern, tool in _PATTERNS if fnmatchcase(name, pattern)), None)
