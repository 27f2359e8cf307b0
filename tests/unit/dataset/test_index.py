"""index.parquet: rows come back as they were, whatever columns the first ones lack."""

from __future__ import annotations

import pyarrow.parquet as pq
import pytest

from forestgen.core.errors import DatasetError, OutputError
from forestgen.dataset.index import COLUMNS, DrawTypes, read_index, write_index
from support.data_sets import write_rows
from support.error_messages import raises_error

EMPTY = dict.fromkeys(COLUMNS)


def row(number, **values):
    return {
        **EMPTY,
        "frame": f"{number:06d}-eye",
        "folder": f"train/{number:06d}-eye",
        "split": "train",
        "image": number,
        "image_seed": 2**63 - 1 - number,
        "class_pixels": {"sky": number},
        "instance_pixels_histogram": [number, 0, 3],
        "notes": ["schön"] if number % 2 else [],
        "turbidity": 2,
        **values,
    }


def test_rows_come_back(tmp_path):
    rows = [row(number, depth_min_m=0.1 * number) for number in range(1100)]  # several groups
    rows[1099]["draw.site.slope"] = 0.1 + 0.2
    rows[0]["draw.count"] = 3
    write_rows(tmp_path / "index.parquet", rows)
    back = list(read_index(tmp_path / "index.parquet"))
    assert back == [{"draw.count": None, "draw.site.slope": None, **one} for one in rows]
    file = pq.ParquetFile(tmp_path / "index.parquet")
    assert file.num_row_groups > 2
    assert file.schema_arrow.names == [*COLUMNS, "draw.count", "draw.site.slope"]


@pytest.mark.parametrize(
    ("values", "kind", "back"),
    [
        ((1, 2), "int64", [1, 2]),
        ((1, 2.5), "double", [1.0, 2.5]),
        ((True, False), "bool", [True, False]),
        (("noise", "none"), "string", ["noise", "none"]),
        (("none", 3, None), "string", ['"none"', "3", None]),
        ((True, 2), "string", ["true", "2"]),
        ((2**70, 1), "double", [float(2**70), 1.0]),
        ((None, None), "string", [None, None]),
    ],
)
def test_a_draw_has_one_type(tmp_path, values, kind, back):
    write_rows(tmp_path / "i.parquet", [row(k, **{"draw.x": value}) for k, value in enumerate(values)])
    assert str(pq.read_schema(tmp_path / "i.parquet").field("draw.x").type) == kind
    assert [one["draw.x"] for one in read_index(tmp_path / "i.parquet")] == back


def test_the_same_bytes_from_a_stream(tmp_path):
    rows = [row(number, **{"draw.x": number}) for number in range(10)]
    types = DrawTypes()
    for one in rows:
        types.add(one)
    write_rows(tmp_path / "one", rows)
    write_index(tmp_path / "deeper" / "two", iter(rows), types.columns)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "deeper" / "two").read_bytes()


def test_no_rows(tmp_path):
    write_rows(tmp_path / "i.parquet", [])
    assert list(read_index(tmp_path / "i.parquet")) == []
    assert pq.read_schema(tmp_path / "i.parquet").names == list(COLUMNS)


def test_an_unknown_column_is_a_bug(tmp_path):
    with pytest.raises(ValueError, match="colour"):
        write_rows(tmp_path / "i.parquet", [row(0, colour="red")])


def test_what_cannot_be_read_or_written(tmp_path):
    with raises_error(DatasetError, place="none"):
        list(read_index(tmp_path / "none"))
    (tmp_path / "bad").write_bytes(b"PAR1 and no more")
    with raises_error(DatasetError, place="bad"):
        list(read_index(tmp_path / "bad"))
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError):
        write_rows(tmp_path / "folder", [])


def test_the_table_of_columns_names_them_all():
    """The module's own page, and the docs' page of data sets."""
    from pathlib import Path

    import forestgen.dataset.index as module

    page = Path(module.__file__).parents[2] / "docs" / "datasets.md"
    for text in (module.__doc__, page.read_text(encoding="utf-8")):
        rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| ")]
        named = {name.strip(" `") for cell in rows for name in cell.split(",")}
        assert set(COLUMNS) <= named
