"""Sections of the page on what was drawn: sun, weather, season, cameras, the recipe's distributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from forestgen.dataset.report.charts import sun_plot
from forestgen.dataset.report.frames import correlations, named, names, numbers, unit_of
from forestgen.dataset.report.layout import Cell, Part, Row, Section, Table
from forestgen.dataset.report.source import Source
from forestgen.dataset.settings import DRAW

_MOST_DRAWS = 24
_MOST_CHARACTERS = 110  # of a distribution as the recipe has it


def sun_section(source: Source) -> Section:
    """Where the sun stood."""
    frames = source.frames
    parts = (
        sun_plot(frames.numbers("sun_azimuth_deg"), frames.numbers("sun_elevation_deg")),
        numbers(frames, "sun_elevation_deg", "Elevation of the sun", "degrees above the horizon", unit="°"),
        numbers(frames, "sun_azimuth_deg", "Azimuth of the sun", "degrees clockwise from north", unit="°"),
        numbers(frames, "sunlit_share", "Sunlit pixels", "share of what is not sky, %", unit="%", factor=100),
    )
    return Section("sun", "Sun", "No sun is recorded here.", parts=parts)


def weather_section(source: Source) -> Section:
    """Clouds, haze, season, wind."""
    frames = source.frames
    parts = (
        names(frames, "clouds", "Clouds"),
        names(frames, "season", "Season"),
        names(frames, "sky_kind", "Sky"),
        numbers(frames, "cloud_cover", "Cloud cover", "as the recipe asks for, %", unit="%", factor=100),
        numbers(frames, "cloud_share", "Clouds in view", "mean opacity over the sky's pixels, %", unit="%", factor=100),
        numbers(frames, "turbidity", "Turbidity", "turbidity"),
        numbers(frames, "visibility_m", "Visibility in haze", "m", unit="m", log=True),
        numbers(frames, "wind_m_per_s", "Wind", "m/s", unit="m/s"),
    )
    return Section("weather", "Weather and season", "No weather is recorded here.", parts=parts)


def camera_section(source: Source) -> Section:
    """How the cameras look."""
    frames = source.frames
    sides = zip(frames.numbers("width_px"), frames.numbers("height_px"), strict=True)
    parts = (
        names(frames, "camera_kind", "Kind"),
        names(frames, "camera", "Camera"),
        named([f"{width:.0f} x {height:.0f} px" for width, height in sides if width > 0 and height > 0], "Size"),
        numbers(frames, "camera_height_m", "Height above the ground", "m", unit="m"),
        numbers(frames, "camera_pitch_deg", "Pitch", "degrees above the horizon", unit="°"),
        numbers(frames, "camera_azimuth_deg", "Direction of view", "degrees clockwise from north", unit="°"),
        numbers(frames, "hfov_deg", "Horizontal field of view", "degrees", unit="°"),
    )
    return Section("cameras", "Cameras", "No cameras are recorded here.", parts=parts)


def draw_section(source: Source) -> Section:
    """What the recipe's distributions gave, and what goes together."""
    drawn = [name for name in source.frames.names if name.startswith(DRAW)]
    lead = "What the recipe's distributions gave; below each, what the recipe asks for." if drawn else ""
    if len(drawn) > _MOST_DRAWS:
        lead += f" The first {_MOST_DRAWS} of {len(drawn):,}; the index has all."
    absent = "No draws are recorded here: the recipe has no distributions, or the folder has no index."
    parts = [_draw(source, name, source.metadata.draws) for name in drawn[:_MOST_DRAWS]]
    return Section("draws", "Drawn values", absent, lead, parts, _correlations(source, drawn))


def _draw(source: Source, name: str, distributions: Mapping[str, Any]) -> Part | None:
    key, frames = name.removeprefix(DRAW), source.frames
    text = _flow(distributions[key]) if key in distributions else ""
    note = text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 4]} ..."
    if frames.is_number(name):
        unit = unit_of(key)
        return numbers(frames, name, key, unit or "value", unit=unit, note=note)
    return names(frames, name, key, note)


def _flow(value: Any) -> str:
    """A distribution as one would write it on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _correlations(source: Source, drawn: Sequence[str]) -> list[Table]:
    rows = [
        Row(
            f"{one.first.removeprefix(DRAW)} and {one.second.removeprefix(DRAW)}",
            [Cell(f"{one.rank:+.2f}", abs(one.rank))],
        )
        for one in correlations(source.frames, drawn)
    ]
    note = (
        "Spearman's rank correlation over the images. Of two things that always come together, a model may learn one "
        "for the other. What the recipe correlates on purpose is here too."
    )
    return [Table("What goes together", ("pair", "correlation"), rows, note)] if rows else []
