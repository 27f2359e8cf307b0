"""The table of illuminances on the page about light is what the program gives."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from forestgen.atmosphere.daylight import daylight, illuminance

DOCS = Path(__file__).parents[3] / "docs"
ROW = re.compile(r"^\| (\d+)° \|(.*)\|$", re.MULTILINE)


def test_the_table_of_illuminances_is_current() -> None:
    rows = [row for page in sorted(DOCS.glob("light*.md")) for row in ROW.findall(page.read_text())]
    assert len(rows) >= 8
    for elevation, cells in rows:
        numbers = [float(cell.replace(",", "")) for cell in cells.split("|")]
        sine = np.sin(np.radians(float(elevation)))
        sun, sky = 127_500 * np.exp(-0.21 / sine) * sine, 800 + 15_500 * np.sqrt(sine)
        clear, clearer = daylight(float(elevation), 3.0), daylight(float(elevation), 2.0)
        totals = [illuminance(one.on_level) for one in (clear, clearer)]
        shares = [illuminance(one.sun_on_level) / illuminance(one.on_level) for one in (clear, clearer)]
        assert [numbers[0], numbers[3]] == pytest.approx(totals, abs=0.6)
        assert numbers[2] == pytest.approx(sun + sky, abs=0.6)
        assert numbers[4:] == pytest.approx([*shares, sun / (sun + sky)], abs=0.006)
