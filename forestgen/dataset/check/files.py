"""Findings, and files read or refused in one sentence. The libraries' readers, and none of the writers' code.

A recipe's YAML is long for its species, whose numbers do not matter here; reading all of it takes longer than all other
checks of an image. So only some of its sections are read. Drawn recipes are written in block style: sections start at
a line's beginning.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import DatasetError
from forestgen.dataset.exr_chunks import read_whole
from forestgen.dataset.safe_path import SafePath, load_json, one_line, read_parquet, reading
from forestgen.recipe.sources import parse_yaml

if TYPE_CHECKING:
    from PIL.Image import Image

_SECTION = re.compile(r"(?m)^(?=[A-Za-z_]\w*:)")
_WANTED = ("labels", "dataset", "wind", "render")
_OTHERS = "others"  # in a class: all species that no class names
MISUNDERSTOOD = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True)
class Finding:
    """One place where a data set contradicts itself."""

    file: str  # relative to the data set's folder; "" until the check says that it is its own
    problem: str  # one sentence
    expected: str = ""
    got: str = ""
    image: str = ""  # the frame's folder
    plant_id: int | None = None
    pixel: tuple[int, int] | None = None  # x, y from the upper left
    check: str = ""  # name of the check that found it

    @property
    def where(self) -> str:
        """File, image, plant and pixel, for people."""
        places = [self.file]
        if self.image and not self.file.startswith(f"{self.image}/"):
            places.append(f"image {self.image}")
        if self.plant_id is not None:
            places.append(f"plant_id {self.plant_id}")
        if self.pixel is not None:
            places.append(f"pixel x {self.pixel[0]}, y {self.pixel[1]}")
        return ", ".join(places)


def finding(
    problem: str,
    expected: object = "",
    got: object = "",
    plant_id: int | None = None,
    *,
    pixel: tuple[int, int] | None = None,
    file: str = "",
    image: str = "",
) -> Finding:
    """A finding of any values, in the check's own file unless another one is named."""
    return Finding(file, problem, as_text(expected), as_text(got), image, plant_id, pixel)


def as_text(value: object) -> str:
    """A value in plain figures; of an array, such as a box or a position, a few."""
    if isinstance(value, np.ndarray):
        return " ".join(map(as_text, value.ravel()[:8]))
    if isinstance(value, float | np.floating):
        return f"{float(value):.9g}"
    return str(value.item() if isinstance(value, np.generic) else value)


class UnreadableError(Exception):
    """A file that cannot be read or understood."""

    def __init__(self, finding: Finding) -> None:
        self.finding = finding
        super().__init__(finding.where)


def misunderstood(file: str, error: Exception, image: str = "", plant_id: int | None = None) -> Finding:
    """The finding of content that a check cannot understand; `error` is one of `MISUNDERSTOOD`."""
    reason = f"{type(error).__name__}: {error}"
    return Finding(file, "the content is not of this format", got=reason[:200], image=image, plant_id=plant_id)


def read_bytes(root: Path, name: str) -> bytes:
    with _reading(root, name) as path:
        return path.read()


def read_text(root: Path, name: str) -> str:
    with _reading(root, name) as path:
        return path.read().decode("utf-8")


def read_json(root: Path, name: str) -> Any:
    try:
        return load_json(read_text(root, name))
    except ValueError as error:
        raise UnreadableError(Finding(name, "this is no JSON", got=one_line(error))) from error


def read_exr(root: Path, name: str) -> tuple[dict[str, dict[str, NDArray[Any]]], dict[str, Any]]:
    """Part -> channel -> (H, W) array in the type it was stored in; and the first part's header."""
    with _reading(root, name) as path:
        return read_whole(path)


def read_picture(root: Path, name: str) -> NDArray[Any]:
    """(H, W) or (H, W, 3) pixels of a PNG; a palette's indices, not its colours."""
    with _picture(root, name, "PNG") as image:
        return np.asarray(image)


def read_jpeg(root: Path, name: str) -> NDArray[Any]:
    """(H, W, 3) pixels of a JPEG."""
    with _picture(root, name, "JPEG") as image:
        return np.asarray(image.convert("RGB"))


def read_bit_depth(root: Path, name: str) -> int:
    """Bits a sample of a PNG, or a palette's index, as its header says; of a file without a header 0."""
    header = read_bytes(root, name)[:26]  # signature 8, chunk's length and type 8, width and height 8, bit depth 1
    return header[24] if header[12:16] == b"IHDR" and len(header) == 26 else 0


def read_palette(root: Path, name: str) -> tuple[list[int], dict[str, str]]:
    """Colours of a palette PNG, red, green, blue, red, ..., and its texts; of another PNG no colours."""
    with _picture(root, name, "PNG") as image:
        image.load()
        texts = {str(key): value for key, value in image.info.items() if isinstance(value, str)}
        return list(image.getpalette() or []), texts


def read_table(root: Path, name: str) -> dict[str, NDArray[Any]]:
    """Columns of a Parquet file; null is NaN, and None among texts."""
    with _reading(root, name) as path:
        table = read_parquet(path)
        return {column: table[column].to_numpy() for column in table.column_names}


def unreadable(path: SafePath, error: Exception) -> UnreadableError:
    if isinstance(error, FileNotFoundError):
        return UnreadableError(Finding(path.name, "the file is missing"))
    return UnreadableError(Finding(path.name, "the file cannot be read", got=one_line(error)))


def _reading(root: Path, name: str) -> AbstractContextManager[SafePath]:
    """A file that is read in this block; what fails becomes `UnreadableError`."""
    return reading(SafePath(root, name), unreadable)


@contextmanager
def _picture(root: Path, name: str, kind: str) -> Iterator[Image]:
    import warnings

    from PIL import Image

    with _reading(root, name) as path, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a picture's size
        with path.open() as stream, Image.open(stream, formats=(kind,)) as image:
            yield image


def read_recipe(root: Path, name: str) -> dict[str, Any]:
    """Sections labels, dataset, wind and render of a drawn recipe, and the names of all that has instances.

    Those, as `species`, are its species and then the kinds of its buildings, as in `Recipe.labelled_names`.
    """
    try:
        recipe = parse_yaml(_excerpt(read_text(root, name)), name, error=DatasetError)[0]
    except DatasetError as error:
        raise UnreadableError(Finding(name, error.problem, error.expected or "", error.got or "")) from error
    if not isinstance(recipe, dict) or not isinstance(recipe.get("species"), dict):
        raise UnreadableError(Finding(name, "this is no drawn recipe", expected="a mapping with species"))
    sections = {key: recipe.get(key) or {} for key in _WANTED}
    for key, section in sections.items():
        if not isinstance(section, dict):
            raise UnreadableError(Finding(name, f"{key} is no section", expected="a mapping", got=str(section)[:80]))
    site = recipe.get("site")
    kinds = [one["kind"] for one in site["buildings"]] if isinstance(site, dict) and site.get("buildings") else []
    return {**sections, "species": [*map(str, recipe["species"]), *dict.fromkeys(map(str, kinds))]}


def _excerpt(text: str) -> str:
    """The wanted sections, the species' names without what they are, and the kinds of buildings."""
    sections = {block.partition(":")[0]: block for block in _SECTION.split(text)}
    kept = [sections[key] for key in _WANTED if key in sections]
    species = sections.get("species", "")
    if species.startswith("species:\n"):
        names = re.findall(r"(?m)^  (\S[^:\n]*):", species)
        species = "species:\n" + "".join(f"  {name}:\n" for name in names)
    kinds = re.findall(r"(?m)^  - kind: \S+\n", sections.get("site", "").partition("\n  buildings:\n")[2])
    site = ["site:\n  buildings:\n", *kinds] if kinds else []
    return "".join([species, *site, *kept])


def class_names(recipe: Mapping[str, Any]) -> list[str]:
    """Semantic class number -> name, by a drawn recipe."""
    own = recipe["labels"].get("classes") or recipe["species"]
    return ["nothing", "ground", *(str(name) for name in own)]


def categories(recipe: Mapping[str, Any]) -> tuple[list[str], dict[str, str]]:
    """Names of instances' categories in order, and species -> category: its class, that of others, or itself."""
    species = recipe["species"]
    classes = recipe["labels"].get("classes") or {name: [name] for name in species}
    names, found = [], {}
    for name, members in classes.items():
        named = [member for member in members if member in species]
        found.update(dict.fromkeys(named, str(name)))
        if named or _OTHERS in members:
            names.append(str(name))
    rest = [str(name) for name, members in classes.items() if _OTHERS in members and _OTHERS not in species]
    for one in species:
        if one not in found:
            found[one] = rest[0] if rest else one
            names += [] if rest else [one]
    return names, found
