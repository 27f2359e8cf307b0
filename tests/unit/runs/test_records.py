"""Records: what is written is read, and what is damaged vouches for nothing."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from forestgen.core.errors import DatasetError
from forestgen.runs.contract import JobRecord
from forestgen.runs.records import done_keys, read_record, record_bytes, record_path, records_of
from forestgen.runs.storage import LocalStorage
from support.error_messages import raises_error

KEY = "000007-" + "ab" * 20
RECORD = JobRecord(
    key=KEY,
    image=7,
    split="train",
    image_seed=2**62,
    recipe_hash="cd" * 32,
    rows=({"frame": "000007-left", "depth": 0.1, "draw.sky": None, "classes": {"ground": 3}},),
    files={"train/000007-left/mask.png": {"bytes": 3, "sha256": "ef" * 32}},
    report={"counts": {"épicéa": 3}},
    notes=("image 7: fog",),
)


def test_a_record_survives_the_way_to_disk_and_back() -> None:
    assert read_record(record_bytes(RECORD), "here") == RECORD
    assert record_bytes(read_record(record_bytes(RECORD), "here")) == record_bytes(RECORD)


def test_the_order_of_files_changes_no_byte() -> None:
    said = {"bytes": 1, "sha256": "00" * 32}
    one, other = (dict.fromkeys(names, said) for names in (("a/b/c", "a/d/e"), ("a/d/e", "a/b/c")))
    assert record_bytes(replace(RECORD, files=one)) == record_bytes(replace(RECORD, files=other))


@given(cut=st.integers(0, len(record_bytes(RECORD)) - 3))
def test_half_a_record_is_none(cut: int) -> None:
    with pytest.raises(DatasetError, match="damaged"):
        read_record(record_bytes(RECORD)[:cut], "here")


@given(at=st.integers(0, len(record_bytes(RECORD)) - 1), bit=st.integers(0, 7))
def test_a_record_with_one_wrong_bit_is_none(at: int, bit: int) -> None:
    content = bytearray(record_bytes(RECORD))
    content[at] ^= 1 << bit
    content[-1:] = b"\n"  # white space after the JSON says nothing
    with pytest.raises(DatasetError, match="damaged") if at < len(content) - 1 else nullcontext():
        read_record(bytes(content), "here")


@pytest.mark.parametrize(
    "change",
    [
        {"image": 8},  # not its key's
        {"image": -7},
        {"image_seed": 2**64},
        {"rows": ({"split": "train"},)},
        {"rows": ({"frame": "../../000007-left"},)},
        {"files": {"../x": {"bytes": 3, "sha256": "ef" * 32}}},
        {"files": {"/etc/passwd": {"bytes": 3, "sha256": "ef" * 32}}},
        {"files": {".forestgen/lock": {"bytes": 3, "sha256": "ef" * 32}}},
        {"files": {"train/x": {"bytes": "3", "sha256": "ef" * 32}}},
        {"files": {"train/x": {"bytes": 3}}},
    ],
)
def test_what_a_stranger_writes_into_a_record_is_refused(change: dict[str, object]) -> None:
    """Its sum is right, and what it says is not."""
    with raises_error(DatasetError, place="here"):
        read_record(record_bytes(replace(RECORD, **change)), "here")


def test_a_whole_record_of_another_version_is_not_called_damaged(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as older:
        older.setattr("forestgen.runs.records._SCHEMA", "forestgen-job/0")
        content = record_bytes(RECORD)
    with raises_error(DatasetError, place="here"):
        read_record(content, "here")


def test_json_without_end_is_damaged() -> None:
    with raises_error(DatasetError, place="here"):
        read_record(b"[" * 200_000, "here")


@pytest.mark.parametrize("split", ["", "..", "../x", "/etc", "a/b", ".forestgen", "Train"])
def test_a_split_of_a_stranger_is_no_path(split: str) -> None:
    with raises_error(DatasetError, place="here"):
        read_record(record_bytes(replace(RECORD, split=split)), "here")


def test_records_come_by_image_and_damaged_ones_are_told(tmp_path: Path) -> None:
    place = LocalStorage(tmp_path)
    numbers = [3, 1, 1_000_001, 20, 0, 999_999]
    for number in numbers:
        key = f"{number:06d}-" + "ab" * 20
        place.write(record_path(key), record_bytes(replace(RECORD, key=key, image=number)))
    place.write(record_path("000004-" + "00" * 20), b"{")
    place.write(record_path("000005-" + "00" * 20), record_bytes(RECORD))  # under another's name
    place.write(".forestgen/jobs/notes.txt", b"mine")
    told: list[str] = []
    assert [record.image for record in records_of(place, told.append)] == sorted(numbers)
    assert len(told) == 1
    assert "000004" in told[0]
    assert len(done_keys(place)) == len(numbers) + 2


def test_a_place_without_records_has_none(tmp_path: Path) -> None:
    assert list(records_of(LocalStorage(tmp_path / "nowhere"))) == []
