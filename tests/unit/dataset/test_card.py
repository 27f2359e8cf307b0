"""The data card: front matter that parses, tables that add up, texts that stay texts."""

from __future__ import annotations

from dataclasses import replace

import pytest
from dataset_shots import SETTINGS
from ruamel.yaml import YAML

from forestgen.dataset.card import CardCounts, card_text

VERSION = {
    "versions_hash": "0",
    "packages": {"numpy": "2.0"},
    "python": "3.11",
    "platform": {"system": "Linux", "machine": "x"},
}
ROWS = [
    {
        "split": split,
        "class_pixels": {"nothing": 10, "oak": 1},
        "category_instances": {"oak": 1},
        "species_instances": {"oak": 1},
        "species_pixels": {"oak": 1},
        "plants_in_view": 1,
        "width_px": 4,
        "height_px": 3,
        "camera_kind": "perspective",
        "relative_error": error,
    }
    for split, error in (("train", 0.1), ("train", None), ("val", 0.3))
]


def described(settings, **more):
    return {
        "description": settings.description,
        "images": 3,
        "frames": 3,
        "recipes": [
            {
                "file": "recipe.yaml",
                "hash": "ab" * 32,
                "root_seed": 7,
                "images": 5,
                "first_image": 0,
                "missing": [[1, 2]],
                "draws": {"sky.turbidity": {"uniform": [2, 6]}},
            }
        ],
        "splits": {"train": {"images": 2, "frames": 2}, "val": {"images": 1, "frames": 1}},
        "made_with": [VERSION],
        **more,
    }


def card(settings, rows=ROWS, **more):
    counts = CardCounts()
    for row in rows:
        counts.add(row)
    return card_text(described(settings, **more), counts, settings)


def front(text):
    _, matter, rest = text.split("---\n", 2)
    return YAML(typ="safe").load(matter), rest


def cells(text, first):
    """The cells of the table's row that begins with `first`."""
    line = next(line for line in text.splitlines() if line.startswith(f"| {first} |"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_tables_add_up():
    _, text = front(card(SETTINGS))
    assert cells(text, "train") == ["train", "2", "2", "2"]
    assert cells(text, "val") == ["val", "1", "1", "1"]
    assert cells(text, "4") == ["4", "oak", "3", "9.09 %", "3"]
    assert cells(text, "0") == ["0", "nothing", "30", "90.9 %", "3"]
    assert cells(text, "oak") == ["oak", "3"]
    assert "| oak | 3 | 3 |" in text
    assert "2 images that were asked for are not here" in text
    assert "at most 0.3 here" in text
    assert "| recipe.yaml | sky.turbidity |" in text


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("CC BY 4.0", {"license": "cc-by-4.0"}),
        ("CC-BY-NC-SA-4.0", {"license": "cc-by-nc-sa-4.0"}),
        ("", {"license": "unknown"}),
        ("House rules: v2", {"license": "other", "license_name": "House rules: v2", "license_link": "https://x.org"}),
    ],
)
def test_licences(name, expected):
    matter, _ = front(card(replace(SETTINGS, licence_name=name, licence_url="https://x.org" if name else "")))
    assert {key: value for key, value in matter.items() if key.startswith("license")} == expected


def test_texts_stay_texts():
    """A description with the signs of YAML, Markdown and HTML."""
    wild = 'a: "b"\n# {{ 7 * 7 }} | <script>x</script> --- `é`'
    matter, rest = front(card(replace(SETTINGS, description=wild)))
    assert matter["pretty_name"] == wild
    assert "49" not in rest.splitlines()[1]
    assert "<script>" not in rest
    assert rest.splitlines()[1].startswith('# a: "b" \\# ')


@pytest.mark.parametrize(("frames", "size"), [(3, "n<1K"), (1000, "1K<n<10K"), (50_000, "10K<n<100K")])
def test_size_category(frames, size):
    assert front(card(SETTINGS, frames=frames))[0]["size_categories"] == [size]


def test_an_empty_data_set_has_a_card():
    text = card(SETTINGS, rows=[], frames=0, images=0, splits={})
    assert front(text)[0]["size_categories"] == ["n<1K"]
    assert text.endswith("\n")
