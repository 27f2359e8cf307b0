"""What light meters read, for people: a table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

from forestgen.core.figures import count, table_lines
from forestgen.instruments.light import LightMeter, Quantity, sampled


class LightReadings(list[LightMeter]):
    """Meters in the order of the points, and at each in that of the directions.

    Parameters
    ----------
    step_nm : of the spectra that the text tells; None: it tells none.
    """

    def __init__(self, meters: Iterable[LightMeter], step_nm: float | None = None) -> None:
        super().__init__(meters)
        self.step_nm = step_nm

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        return f"<LightReadings: {count(len(self), 'meter')}>"

    def lines(self) -> Iterator[str]:
        """The table, what its columns mean, and notes."""
        yield from table_lines(_rows(self), names_left=False)
        yield "x, y and z (above ground) in metres; PAR: µmol/m²/s of 400 to 700 nm; W/m² of 300 to 2500 nm"
        yield "sun, sky: their direct shares of the lux; the rest was scattered by plants and ground; ± standard error"
        if self.step_nm is not None:
            yield from _spectra(self, self.step_nm)
        for number, meter in enumerate(self, start=1):
            if meter.note:
                yield f"note: point {number}: {meter.note}"


def _rows(meters: Sequence[LightMeter]) -> list[list[str]]:
    turned = {meter.normal for meter in meters} != {(0.0, 0.0, 1.0)}
    rows = [
        ["x", "y", "z", *(["normal"] if turned else []), "lux", "sun", "sky", "scattered", "CCT (K)", "PAR", "W/m²"]
    ]
    for meter in meters:
        scattered = 1.0 - meter.from_sun.value - meter.from_sky.value
        shares = (meter.from_sun.value, meter.from_sky.value, scattered)
        rows.append(
            [
                *(f"{value:g}" for value in meter.point_m[:2]),
                f"{meter.above_ground_m:.2f}",
                *([",".join(f"{value:.2g}" for value in meter.normal)] if turned else []),
                told(meter.illuminance_lux),
                *(f"{100 * max(share, 0.0):.1f}%" for share in shares),
                "none" if math.isnan(meter.cct_k.value) else told(meter.cct_k),
                told(meter.par_umol_per_m2_s),
                told(meter.irradiance_w_per_m2),
            ]
        )
    return rows


def _spectra(meters: Sequence[LightMeter], step_nm: float) -> Iterator[str]:
    columns = [sampled(meter, step_nm) for meter in meters]
    rows = [["nm", *(f"point {number + 1}" for number in range(len(meters)))]]
    rows += [[f"{row[0][0]:g}", *(f"{value:.4g}" for _, value, _ in row)] for row in zip(*columns, strict=True)]
    yield ""
    yield from table_lines(rows, names_left=False)
    yield "W/m²/nm, means over each step"


def told(one: Quantity) -> str:
    """A value to at most five digits and no more than its error leaves, and that error."""
    value, error = one.value, one.error
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    places = 4 - math.floor(math.log10(abs(value)))
    if not (math.isfinite(error) and error > 0):
        return _plain(value, places)
    places = min(places, 1 - math.floor(math.log10(error)))
    return f"{_plain(value, places)} ± {_plain(max(error, 10.0**-places), places)}"


def _plain(value: float, places: int) -> str:
    """Rounded to decimal places; a negative number of them rounds to tens, hundreds, ..."""
    return f"{round(value, places):,.{max(places, 0)}f}"
