"""Lists of trees: text with a line of names and a tree a line, as inventories and spreadsheets write them.

Cells are separated by commas, semicolons or tabs, whichever the first line has most of; with the latter two, decimals
may have a comma. Text is UTF-8, UTF-16 with its mark, or else Windows-1252. Empty lines and lines that begin with ``#``
are passed over. An empty cell, or ``NA``, is a value that is not known.
"""

from __future__ import annotations

import codecs
import difflib
import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Floats
from forestgen.core.errors import RecipeError

MOST_ROWS = 5_000_000
NUMBERS = {  # column: what its values are
    "x_m": (-1e8, 1e8, "a number of metres"),
    "y_m": (-1e8, 1e8, "a number of metres"),
    "dbh_cm": (0.0, 1500.0, "a diameter above 0, at most 1500 cm"),
    "dbh_m": (0.0, 15.0, "a diameter above 0, at most 15 m; centimetres are in a column dbh_cm"),
    "height_m": (0.0, 130.0, "a height above 0, at most 130 m"),
    "crown_radius_m": (0.0, 40.0, "a radius above 0, at most 40 m"),
    "crown_width_m": (0.0, 80.0, "a width above 0, at most 80 m"),
    "crown_base_m": (0.0, 130.0, "a height above 0, at most 130 m"),
    "age_yr": (-1e-9, 1e4, "years, at least 0"),
    "azimuth_deg": (-360.000001, 360.0, "degrees from -360 to 360"),
    "stems_per_ha": (0.0, 1e7, "a number above 0"),
    "count": (0.0, 1e7, "a number above 0"),
}
COLUMNS = ("species", "status", *NUMBERS)
_EXCLUSIVE = (("dbh_cm", "dbh_m"), ("crown_radius_m", "crown_width_m"), ("stems_per_ha", "count"))
_DEAD = {"": False, "alive": False, "living": False, "live": False, "dead": True, "standing_dead": True}
_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?$"
_NEAR = 0.7  # likeness of a column's name to a known one, above which it is a slip of the pen


@dataclass(frozen=True)
class TreeList:
    """The columns of a list that the model knows, as numbers; NaN where a value is not known."""

    name: str  # of the file
    line: NDArray[np.int64]  # (N,) line of the file
    species: NDArray[np.int32]  # (N,) index in `species_names`
    species_names: tuple[str, ...]  # as in the file
    dead: NDArray[np.bool_]  # (N,)
    numbers: Mapping[str, Floats]  # (N,) each, dbh as dbh_m and crowns as crown_radius_m
    ignored: tuple[str, ...]  # names of columns that mean nothing here

    def __len__(self) -> int:
        return len(self.line)

    @property
    def nbytes(self) -> int:
        own = self.line.nbytes + self.species.nbytes + self.dead.nbytes
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
    lines = _text(content, name).splitlines()
    used = [i for i, line in enumerate(lines) if line.strip(' \t,;"') and not line.lstrip().startswith("#")]
    if len(used) < 2:
        problem, expected = "no trees are listed", "a line of names such as species,x_m,y_m,dbh_cm, then a tree a line"
        got = "an empty file" if not used else f"one line: {lines[used[0]][:80]!r}"
        raise RecipeError(problem, where=name, expected=expected, got=got)
    if len(used) - 1 > MOST_ROWS:
        expected, hint = f"at most {MOST_ROWS:,} lines", "cut the list to the trees on the site"
        raise RecipeError("too many trees", where=name, expected=expected, got=f"{len(used) - 1:,}", hint=hint)
    header = lines[used[0]]
    mark = max(",;\t", key=header.count)
    names = [one.strip().strip('"').strip() for one in header.split(mark)]
    known = _known_names(names, columns, name)
    table = _cells([lines[i] for i in used[1:]], names, mark, name, np.array(used[1:]) + 1)
    return _typed(table, known, names, name, np.array(used[1:], dtype=np.int64) + 1, decimal_comma=mark != ",")


def _text(content: bytes, name: str) -> str:
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", errors="replace")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    if "\0" in text:
        problem, expected = "this is no text", "comma-separated values, as spreadsheets save them (CSV)"
        raise RecipeError(problem, where=name, expected=expected, got=ascii(text[:20]))
    return text


def _known_names(names: list[str], columns: Mapping[str, str], name: str) -> dict[str, int]:
    """Which of `COLUMNS` is which column of the file."""
    where, listed = f"{name}, line 1", ", ".join(names)[:200]
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
        near = difflib.get_close_matches(one.lower(), [c for c in COLUMNS if c not in found], 1, _NEAR)
        if one not in columns and one.lower() not in found and near:
            hint = f"if it is another one: `columns: {{{one}: ...}}` names columns; those of other names are left out"
            raise RecipeError("unknown column", where=where, expected=f"{near[0]}", got=one, hint=hint)
    missing = [one for one in ("species",) if one not in found]
    if ("x_m" in found) != ("y_m" in found):
        missing.append("y_m" if "x_m" in found else "x_m")
    if not {"dbh_cm", "dbh_m", "height_m"} & {*found}:
        missing.append("dbh_cm, dbh_m or height_m")
    if missing:
        hint = "`columns: {BHD: dbh_cm, Art: species}` gives the file's names a meaning"
        expected = f"the columns species, a size, and x_m, y_m; {' and '.join(missing)} is not there"
        raise RecipeError("columns are missing", where=where, expected=expected, got=listed, hint=hint)
    for pair in _EXCLUSIVE:
        if {*pair} <= {*found}:
            raise RecipeError("two columns for one thing", where=where, expected=" or ".join(pair), got=listed)
    return found


def _cells(lines: list[str], names: list[str], mark: str, name: str, number: NDArray[np.int64]) -> Any:
    """The cells of all lines as a pyarrow table of texts."""
    from pyarrow import ArrowInvalid, csv, string

    wrong: list[Any] = []

    def skip(row: Any) -> str:
        wrong.append(row)
        return "skip"

    keys = [str(i) for i in range(len(names))]
    try:
        table = csv.read_csv(
            io.BytesIO("\n".join(lines).encode()),
            read_options=csv.ReadOptions(use_threads=False, column_names=keys),
            parse_options=csv.ParseOptions(delimiter=mark, invalid_row_handler=skip),
            convert_options=csv.ConvertOptions(column_types=dict.fromkeys(keys, string()), strings_can_be_null=False),
        )
    except ArrowInvalid as cause:
        raise RecipeError(
            "not a list of trees", where=name, expected="lines of equal length", got=str(cause)
        ) from cause
    if wrong:
        row = wrong[0]
        line = number[lines.index(row.text)] if row.text in lines else number[0]
        hint = "decimal commas need semicolons or tabs between the values" if mark == "," else None
        problem, expected = "a line has another number of values", f"{len(names)}: {mark.join(names)}"
        got = f"{row.actual_columns}: {row.text[:100]}"
        raise RecipeError(problem, where=f"{name}, line {line}", expected=expected, got=got, hint=hint)
    return table


def _typed(
    table: Any, known: Mapping[str, int], names: list[str], name: str, line: NDArray[np.int64], *, decimal_comma: bool
) -> TreeList:
    import pyarrow.compute as pc

    trimmed = {column: pc.utf8_trim_whitespace(table.column(index)) for column, index in known.items()}
    species = trimmed["species"].combine_chunks().dictionary_encode()
    called = tuple(species.dictionary.to_pylist())
    code = species.indices.to_numpy(zero_copy_only=False).astype(np.int32)
    if "" in called:
        row = int(np.flatnonzero(code == called.index(""))[0])
        raise RecipeError("no species", where=f"{name}, line {line[row]}", expected="a species' name", got="nothing")
    dead = np.zeros(len(line), dtype=np.bool_)
    if "status" in trimmed:
        status = pc.utf8_lower(trimmed["status"]).combine_chunks().dictionary_encode()
        words, which = status.dictionary.to_pylist(), status.indices.to_numpy(zero_copy_only=False)
        for index, word in enumerate(words):
            if word not in _DEAD and word != "na":
                row = int(np.flatnonzero(which == index)[0])
                expected = "alive, dead or nothing, which is alive"
                raise RecipeError(
                    "unknown status", where=f"{name}, line {line[row]}", expected=expected, got=repr(word)
                )
        dead = np.array([_DEAD.get(word, False) for word in words])[which]
    numbers = {
        one: _numbers(trimmed[one], one, name, line, decimal_comma=decimal_comma) for one in NUMBERS if one in trimmed
    }
    if "dbh_cm" in numbers:
        numbers["dbh_m"] = numbers.pop("dbh_cm") / 100.0
    if "crown_width_m" in numbers:
        numbers["crown_radius_m"] = numbers.pop("crown_width_m") / 2.0
    ignored = tuple(one for index, one in enumerate(names) if index not in known.values())
    return TreeList(name, line, code, called, dead, numbers, ignored)


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
    got = repr(cells[row].as_py()) + (f", and {count - 1:,} more such lines" if count > 1 else "")
    hint = "correct it, or leave the cell empty where the value is not known"
    raise RecipeError(f"bad {column}", where=f"{name}, line {line[row]}", expected=meaning, got=got, hint=hint)
