"""Lists of trees: text with a line of names and a tree a line, as inventories and spreadsheets write them.

Cells are separated by commas, semicolons or tabs, whichever gives the line of names most cells; with the latter two,
decimals may have a comma. A cell in quotation marks may have separators and line breaks. Text is UTF-8, UTF-16 with its
mark, or else Windows-1252. Empty lines and lines that begin with ``#`` are passed over. An empty cell, or ``NA``, is a
value that is not known.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Floats
from forestgen.core.dead_wood import CLASSES, DeadForm
from forestgen.core.errors import RecipeError

MOST_ROWS = 5_000_000
TALLEST_M = 130.0
NUMBERS = {  # column: what its values are
    "x_m": (-1e8, 1e8, "a number of metres"),
    "y_m": (-1e8, 1e8, "a number of metres"),
    "dbh_cm": (0.0, 1500.0, "a diameter above 0, at most 1500 cm"),
    "dbh_m": (0.0, 15.0, "a diameter above 0, at most 15 m; centimetres are in a column dbh_cm"),
    "height_m": (0.0, TALLEST_M, "a height above 0, at most 130 m"),
    "crown_radius_m": (0.0, 40.0, "a radius above 0, at most 40 m"),
    "crown_width_m": (0.0, 80.0, "a width above 0, at most 80 m"),
    "crown_base_m": (-1e-9, TALLEST_M, "a height of at least 0, at most 130 m"),
    "decay_class": (0.0, float(CLASSES), "a decay class of a dead tree, 1 to 5"),
    "age_yr": (-1e-9, 1e4, "years, at least 0"),
    "azimuth_deg": (-360.000001, 360.0, "degrees from -360 to 360"),
    "stems_per_ha": (0.0, 1e7, "a number above 0"),
    "count": (0.0, 1e7, "a number above 0"),
}
COLUMNS = ("species", "status", *NUMBERS)
_EXCLUSIVE = (("dbh_cm", "dbh_m"), ("crown_radius_m", "crown_width_m"), ("stems_per_ha", "count"))
_FORMS = {
    **dict.fromkeys(("", "alive", "living", "live"), DeadForm.NONE),
    **dict.fromkeys(("dead", "standing_dead"), DeadForm.STANDING),
    **dict.fromkeys(("lying_dead", "uprooted"), DeadForm.UPROOTED),
    "snapped": DeadForm.SNAPPED,
}
_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?$"
_MARKS = ",;\t"
_PASSED_OVER = re.compile(r'[\s,;"]*$|\s*#|sep=.\s*$')  # empty, a comment, what spreadsheets write for themselves
_BLOCK = 100_000  # lines
_UNITS = {"cm": "centimetres", "m": "metres"}
_NEAR = 0.7  # likeness of a column's name to a known one, above which it is a slip of the pen


@dataclass(frozen=True)
class TreeList:
    """The columns of a list that the model knows, as numbers; NaN where a value is not known."""

    name: str  # of the file
    head: str  # where its line of names stands, for messages
    line: NDArray[np.int64]  # (N,) line of the file
    species: NDArray[np.int32]  # (N,) index in `species_names`
    species_names: tuple[str, ...]  # as in the file
    form: NDArray[np.uint8]  # (N,) `core.dead_wood.DeadForm`
    numbers: Mapping[str, Floats]  # (N,) each, dbh as dbh_m and crowns as crown_radius_m
    names: tuple[str, ...]  # of all columns, as in the file
    ignored: tuple[str, ...]  # names of columns that mean nothing here

    def __len__(self) -> int:
        return len(self.line)

    @property
    def dead(self) -> NDArray[np.bool_]:
        """(N,) whether a tree is dead."""
        return self.form > 0

    @property
    def nbytes(self) -> int:
        own = self.line.nbytes + self.species.nbytes + self.form.nbytes
        return own + sum(one.nbytes for one in self.numbers.values())

    def number(self, name: str) -> Floats:
        """(N,) a column, NaN if the list has none of the name."""
        return self.numbers.get(name, np.full(len(self), np.nan))

    def place(self, row: int) -> str:
        """File and line, for messages."""
        return f"{self.name}, line {self.line[row]}"


def read_trees(content: bytes, name: str, columns: Mapping[str, str]) -> TreeList:
    """The trees of a file's content. `name`: for messages. `columns`: the file's names for some of `COLUMNS`.

    Raises `RecipeError` for what is no list of trees; values are checked one by one, not against one another.
    """
    text = _text(content, name)
    mark = max(_MARKS, key=lambda one: len(_first_line(text, one)))
    records = _records(text, mark, name)
    at, header = next(records, (0, []))
    if not header:
        raise _no_trees(name, "an empty file")
    head, names = f"{name}, line {at}", [one.strip() for one in header]
    known = _known_names(names, columns, head)
    hint = "decimal commas need semicolons or tabs between the values" if mark == "," else None
    table, line = _cells(records, names, known, name, hint)
    if not len(line):
        raise _no_trees(name, f"one line: {mark.join(names)[:80]!r}")
    ignored = tuple(one for index, one in enumerate(names) if one and index not in known.values())
    return _typed(table, name, head, line, (tuple(names), ignored), decimal_comma=mark != ",")


def _no_trees(name: str, got: str) -> RecipeError:
    expected = "a line of names such as species,x_m,y_m,dbh_cm, then a tree a line"
    return RecipeError("no trees are listed", where=name, expected=expected, got=got)


def _text(content: bytes, name: str) -> str:
    encoding = "utf-8-sig"
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) and not content.startswith(codecs.BOM_UTF32_LE):
        encoding = "utf-16"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    if "\0" in text:
        problem = "this is no text, or in an encoding that is not known"
        expected = "comma-separated values (CSV) in UTF-8, in UTF-16 with its byte order mark, or in Windows-1252"
        hint = "save it as CSV UTF-8"
        raise RecipeError(problem, where=name, expected=expected, got=ascii(text[:20]), hint=hint)
    return text


def _records(text: str, mark: str, name: str) -> Iterator[tuple[int, list[str]]]:
    """The first line and the cells of each record that is neither empty nor a comment."""
    lines = ("\n" if _PASSED_OVER.match(line) else line for line in io.StringIO(text, newline=""))
    reader, line = csv.reader(lines, delimiter=mark, strict=True), 1
    try:
        for cells in reader:
            if cells:
                yield line, cells
            line = reader.line_num + 1
    except csv.Error as cause:
        is_long = "limit" in str(cause)
        problem = "a cell is too long" if is_long else "a quotation mark is not closed, or has text beside it"
        hint = "values are separated by commas, semicolons or tabs; a quotation mark that is alone begins a long cell"
        expected = 'a cell in two marks, "so, for instance", and a mark inside it twice'
        got = io.StringIO(text, newline="").readlines()[line - 1].rstrip()[:80]
        raise RecipeError(problem, where=f"{name}, line {line}", expected=expected, got=got, hint=hint) from cause


def _first_line(text: str, mark: str) -> list[str]:
    """The names of the columns, if this mark separates them."""
    try:
        return next(_records(text, mark, ""), (0, []))[1]
    except RecipeError:
        return []


def _known_names(names: list[str], columns: Mapping[str, str], where: str) -> dict[str, int]:
    """Which of `COLUMNS` is which column of the file."""
    listed = ", ".join(names)[:200]
    absent = [one for one in columns if one not in names]
    if absent:
        raise RecipeError("the list has no such column", where=where, expected=f"{absent[0]!r}", got=listed)
    found: dict[str, int] = {}
    for index, one in enumerate(names):
        column = columns.get(one, one.lower())
        if column in found:
            raise RecipeError("a column is there twice", where=where, expected=f"one {column}", got=listed)
        if column in COLUMNS:
            found[column] = index
    for one in names:
        near = difflib.get_close_matches(one.lower(), [c for c in COLUMNS if c not in found], 2, _NEAR)
        if one not in columns and one.lower() not in found and near:
            near.sort(key=lambda column: not column.endswith("_cm"))  # foresters' own unit first
            unit = _UNITS.get(near[0].rsplit("_", 1)[-1])
            hint = f"`columns: {{{one}: {near[0]}}}` says what it is" + (f", if in {unit}" if unit else "")
            if one.lower().endswith("mm"):
                hint = "no column takes millimetres: write them as dbh_cm, a tenth of the numbers"
            raise RecipeError("unknown column", where=where, expected=" or ".join(near), got=one, hint=hint)
    missing = [one for one in ("species",) if one not in found]
    if ("x_m" in found) != ("y_m" in found):
        missing.append("y_m" if "x_m" in found else "x_m")
    if not {"dbh_cm", "dbh_m", "height_m"} & {*found}:
        missing.append("dbh_cm, dbh_m or height_m")
    if missing:
        hint = "`columns: {BHD: dbh_cm, Art: species}` gives the file's names a meaning"
        hint = hint if len(names) > 1 else "separate the values by commas, semicolons or tabs"
        expected = f"the columns species, a size, and x_m, y_m; {' and '.join(missing)} is not there"
        raise RecipeError("columns are missing", where=where, expected=expected, got=listed, hint=hint)
    for pair in _EXCLUSIVE:
        if {*pair} <= {*found}:
            raise RecipeError("two columns for one thing", where=where, expected=" or ".join(pair), got=listed)
    return found


def _cells(
    records: Iterator[tuple[int, list[str]]], names: list[str], known: Mapping[str, int], name: str, hint: str | None
) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """The cells of the known columns, as pyarrow's texts without blanks around them, and (N,) the line of each tree."""
    import pyarrow as pa
    import pyarrow.compute as pc

    pick, lines = itemgetter(*known.values()), [np.zeros(0, dtype=np.int64)]
    parts: dict[str, list[Any]] = {one: [] for one in known}
    while block := list(islice(records, _BLOCK)):
        wrong = next((one for one in block if len(one[1]) != len(names)), None)
        if wrong is not None:
            problem, expected = "a line has another number of values", f"{len(names)}: {', '.join(names)}"
            got = f"{len(wrong[1])}: {', '.join(wrong[1])[:100]}"
            raise RecipeError(problem, where=f"{name}, line {wrong[0]}", expected=expected, got=got, hint=hint)
        lines.append(np.array([line for line, _ in block], dtype=np.int64))
        for column, cells in zip(known, zip(*(pick(cells) for _, cells in block), strict=True), strict=True):
            parts[column].append(pc.utf8_trim_whitespace(pa.array(cells, pa.string())))
        if sum(map(len, lines)) > MOST_ROWS:
            expected, more = f"at most {MOST_ROWS:,} lines", "cut the list to the trees on the site"
            raise RecipeError("too many trees", where=name, expected=expected, got="more", hint=more)
    return {one: pa.chunked_array(part, pa.string()) for one, part in parts.items()}, np.concatenate(lines)


def _typed(
    table: Mapping[str, Any],
    name: str,
    head: str,
    line: NDArray[np.int64],
    names: tuple[tuple[str, ...], tuple[str, ...]],
    *,
    decimal_comma: bool,
) -> TreeList:
    """The list. `names`: of all columns, and of those without meaning."""
    import pyarrow.compute as pc

    species = table["species"].combine_chunks().dictionary_encode()
    called = tuple(species.dictionary.to_pylist())
    code = species.indices.to_numpy(zero_copy_only=False).astype(np.int32)
    if "" in called:
        row = int(np.flatnonzero(code == called.index(""))[0])
        raise RecipeError("no species", where=f"{name}, line {line[row]}", expected="a species' name", got="nothing")
    form = np.zeros(len(line), dtype=np.uint8)
    if "status" in table:
        status = pc.utf8_lower(table["status"]).combine_chunks().dictionary_encode()
        words, which = status.dictionary.to_pylist(), status.indices.to_numpy(zero_copy_only=False)
        for index, word in enumerate(words):
            if word not in _FORMS and word != "na":
                row = int(np.flatnonzero(which == index)[0])
                expected, where = "alive, dead, lying_dead, snapped, or nothing: alive", f"{name}, line {line[row]}"
                hint = "write these words for the list's codes"
                raise RecipeError("unknown status", where=where, expected=expected, got=repr(word), hint=hint)
        form = np.array([_FORMS.get(word, 0) for word in words], dtype=np.uint8)[which]
    numbers = {
        one: _numbers(table[one], one, name, line, decimal_comma=decimal_comma) for one in NUMBERS if one in table
    }
    if "dbh_cm" in numbers:
        numbers["dbh_m"] = numbers.pop("dbh_cm") / 100.0
    if "crown_width_m" in numbers:
        numbers["crown_radius_m"] = numbers.pop("crown_width_m") / 2.0
    return TreeList(name, head, line, code, called, form, numbers, *names)


def _numbers(cells: Any, column: str, name: str, line: NDArray[np.int64], *, decimal_comma: bool) -> Floats:
    """(N,) the values of a column, each in its range."""
    import pyarrow as pa
    import pyarrow.compute as pc

    text = pc.replace_substring(cells, ",", ".") if decimal_comma else cells
    absent = pc.or_(pc.equal(text, ""), pc.equal(text, "NA"))
    low, high, meaning = NUMBERS[column]
    good = pc.or_(absent, pc.match_substring_regex(text, _NUMBER)).combine_chunks().to_numpy(zero_copy_only=False)
    if good.all():
        filled = pc.if_else(absent, pa.scalar("0"), text)
        values = np.array(pc.cast(filled, pa.float64()).to_numpy(), dtype=np.float64)
        values[absent.combine_chunks().to_numpy(zero_copy_only=False)] = np.nan
        good = np.isnan(values) | ((values > low) & (values <= high))
        if good.all():
            return values
    row = int(np.flatnonzero(~good)[0])
    count = int(np.count_nonzero(~good))
    got = repr(cells[row].as_py()) + (f"; {count:,} such lines" if count > 1 else "")
    hint = "correct it, or leave the cell empty where the value is not known"
    raise RecipeError(f"bad {column}", where=f"{name}, line {line[row]}", expected=meaning, got=got, hint=hint)
