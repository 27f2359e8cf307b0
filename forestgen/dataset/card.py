"""README.md: the data card, for people and for the pages of Hugging Face, which read its front matter."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from forestgen.dataset.formats.format import load_formats
from forestgen.dataset.settings import DatasetSettings

CARD_NAME = "README.md"
_TEMPLATE = Path(__file__).with_name("card.md.jinja")
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))
# Licences that Hugging Face knows by a name of its own.
_LICENCES = re.compile(r"cc0-1\.0|cc-by(-nc)?(-sa|-nd)?-(2\.0|2\.5|3\.0|4\.0)|mit|apache-2\.0|odc-by|odbl|pddl")
_CLASS, _INSTANCES, _SPECIES = "class_pixels", "category_instances", "species_instances"
_COUNTED = (_CLASS, _INSTANCES, _SPECIES, "species_pixels")


class CardCounts:
    """What the card says of the index' rows, gathered row by row."""

    def __init__(self) -> None:
        self.totals: dict[str, Counter[str]] = {name: Counter() for name in _COUNTED}
        self.frames_with: Counter[str] = Counter()  # semantic class -> frames that show it
        self.plants_in_view: Counter[str] = Counter()  # by split
        self.sizes_px: Counter[tuple[int, int]] = Counter()
        self.cameras: Counter[str] = Counter()
        self.relative_error = 0.0  # the largest of any frame

    def add(self, row: Mapping[str, Any]) -> None:
        """Take a row of the index into account."""
        for name, total in self.totals.items():
            total.update(row.get(name) or {})
        self.frames_with.update((row.get(_CLASS) or {}).keys())
        self.plants_in_view[row["split"]] += row.get("plants_in_view") or 0
        self.sizes_px[row.get("width_px") or 0, row.get("height_px") or 0] += 1
        self.cameras[row.get("camera_kind") or "unknown"] += 1
        self.relative_error = max(self.relative_error, row.get("relative_error") or 0.0)


def card_text(description: Mapping[str, Any], counts: CardCounts, settings: DatasetSettings) -> str:
    """The card, of the content of dataset.json and the counts of all rows of the index."""
    pixels = counts.totals[_CLASS]
    every = max(1, sum(pixels.values()))
    return str(
        markdown_template(_TEMPLATE).render(
            said=description,
            counts=counts,
            settings=settings,
            licence=_licence(settings),
            size=next((name for most, name in _SIZES if description["frames"] < most), "n>10M"),
            classes=[
                (number, name, pixels[name], pixels[name] / every, counts.frames_with[name])
                for number, name in enumerate(settings.class_names)
            ],
            categories=[(name, counts.totals[_INSTANCES][name]) for name in settings.category_names],
            species=[
                (name, counts.totals[_SPECIES][name], counts.totals["species_pixels"][name])
                for name in settings.species_names
            ],
            draws=[
                (recipe["file"], key, json.dumps(written, ensure_ascii=False))
                for recipe in description["recipes"]
                for key, written in recipe["draws"].items()
            ],
            sizes=sorted(counts.sizes_px.items()),
            of_formats=[text for one in load_formats(settings.formats) if (text := one.card())],
            missing=sum(last - first + 1 for one in description["recipes"] for first, last in one["missing"]),
        )
    )


@cache
def markdown_template(path: Path) -> Any:
    """The template of a Markdown page, without escapes but those of its filters."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined, autoescape=False
    )
    environment.filters |= {
        "yaml": lambda value: json.dumps(value, ensure_ascii=False),  # JSON's quotes are YAML's
        "cell": markdown,
        "number": "{:,}".format,
        "share": lambda value: f"{100 * value:.3g} %",
    }
    return environment.from_string(path.read_text(encoding="utf-8"))


def _licence(settings: DatasetSettings) -> dict[str, str]:
    """Keys of the front matter."""
    if not settings.licence_name:
        return {"license": "unknown"}
    known = settings.licence_name.strip().lower().replace(" ", "-")
    if _LICENCES.fullmatch(known):
        return {"license": known}
    link = {"license_link": settings.licence_url} if settings.licence_url else {}
    return {"license": "other", "license_name": settings.licence_name, **link}


def markdown(value: object) -> str:
    """A text in a table's cell, on one line, with nothing that Markdown or HTML would take for its own."""
    text = " ".join(str(value).split())
    return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", text)
