"""What `forestgen calibrate` writes: a sheet for people, numbers for programs, and the chart's picture."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Spectrum
from forestgen.dataset.files import write_bytes, write_json
from forestgen.dataset.manifest import package_versions
from forestgen.instruments.colour_chart import BOUND_MODES, CARD_BOUND, MAX_BOUND, MEAN_BOUND, MODES, Calibration
from forestgen.recipe.load import LoadedRecipe
from forestgen.scene import colour_checker as checker

SHEET, NUMBERS, PICTURE = "calibration.html", "calibration.json", "chart.png"
_PACKAGES = ("forestgen", "mitsuba", "drjit", "colour-science", "pvlib", "numpy")
_STYLE = """
:root { --ink: #1d2521; --soft: #5d6a63; --line: #dde3df; --good: #2c7a4b; --bad: #b3372c; --page: #f5f7f5; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 2.5rem 1.5rem 4rem; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; letter-spacing: -.01em; }
h2 { font-size: 1.1rem; margin: 2.4rem 0 .7rem; }
p { max-width: 46rem; margin: .5rem 0; }
.soft, figcaption, td.soft { color: var(--soft); }
.card { background: #fff; border: 1px solid var(--line); border-radius: 10px; padding: 1.1rem 1.3rem; }
.verdict { display: inline-block; padding: .15rem .7rem; border-radius: 99px; color: #fff; font-weight: 600; }
.good { background: var(--good); } .bad { background: var(--bad); }
.facts { display: grid; grid-template-columns: repeat(3, 1fr); gap: .8rem; margin: 1.4rem 0; }
.facts b { display: block; font-size: 1.35rem; font-weight: 600; font-variant-numeric: tabular-nums; }
.facts span { color: var(--soft); font-size: .85rem; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th { text-align: right; font-weight: 600; font-size: .85rem; color: var(--soft); padding: .3rem .5rem; }
td { text-align: right; padding: .22rem .5rem; border-top: 1px solid var(--line); }
th:first-child, td:first-child, .left { text-align: left; }
.swatch { display: inline-block; width: 1.15rem; height: 1.15rem; vertical-align: -.2rem; }
.bar { display: inline-block; height: .55rem; background: #7d9c8b; border-radius: 2px; vertical-align: middle; }
.two { display: grid; grid-template-columns: 1fr 1fr; gap: 1rem; }
@media (max-width: 44rem) { .two, .facts { grid-template-columns: 1fr; } }
.left { white-space: nowrap; }
figure { margin: 0; } figure img, figure svg { width: 100%; height: auto; display: block; border-radius: 4px; }
figcaption { font-size: .85rem; margin-top: .5rem; }
code { font-size: .85em; overflow-wrap: anywhere; }
"""


def write_calibration(folder: Path, found: Calibration, loaded: LoadedRecipe, samples: int) -> None:
    """Write all files into a folder that is there."""
    write_bytes(folder / SHEET, sheet(found, loaded, samples).encode())
    write_json(folder / NUMBERS, numbers(found, loaded, samples))
    write_bytes(folder / PICTURE, _png(_enlarged(found.picture)))


def numbers(found: Calibration, loaded: LoadedRecipe, samples: int) -> dict[str, Any]:
    """All that was measured, as plain values."""
    meter = found.meter
    return {
        "schema": "forestgen-calibration/1",
        "holds": found.holds,
        "recipe": loaded.path.name,
        "recipe_hash": loaded.hash,
        "samples": samples,
        "versions": {name: package_versions()[name] for name in _PACKAGES},
        "chart": {
            "patches": checker.CHART,
            "point_m": list(found.point_m),
            "above_ground_m": found.above_ground_m,
            "normal": list(found.normal),
        },
        "checks": [
            {"name": one.name, "value": one.value, "bound": one.bound, "holds": one.holds} for one in found.checks
        ],
        "delta_e_2000": {
            mode: {"mean": float(found.delta_e(mode).mean()), "max": float(found.delta_e(mode).max())} for mode in MODES
        },
        "light": {
            "illuminance_lux": found.illuminance_lux,
            "illuminance_by_meter_lux": meter.illuminance_lux.value,
            "illuminance_by_meter_error_lux": meter.illuminance_lux.error,
            "from_sun": meter.from_sun.value,
            "from_sky": meter.from_sky.value,
            "unevenness": found.unevenness,
            "cct_k": _number(found.white.cct_k),
            "duv": _number(found.white.duv),
            "white_xy": found.white.xy.tolist(),
            "wavelength_nm": found.light.wavelength_nm.tolist(),
            "irradiance_w_per_m2_nm": found.light.value.tolist(),
        },
        "patches": [
            {
                "name": patch.name,
                "expected_xyz": patch.expected_xyz.tolist(),
                "found_xyz": {mode: xyz.tolist() for mode, xyz in patch.found_xyz.items()},
                "delta_e_2000": dict(patch.delta_e),
                "luminance_error": {mode: _number(error) for mode, error in patch.error.items()},
            }
            for patch in found.patches
        ],
        "notes": list(found.notes),
    }


def sheet(found: Calibration, loaded: LoadedRecipe, samples: int) -> str:
    """The page, with all it needs inside."""
    name = html.escape(loaded.path.name)
    parts = [
        f"<h1>Calibration of {name}</h1>",
        f'<p class="soft">A colour chart and a grey card in the recipe\'s own scene, at {_place(found)}.</p>',
        f"<p>{_badge(found.holds, 'all bounds hold', 'bounds are missed')}</p>",
        _facts(found),
        *(f'<p class="card">{html.escape(note[0].upper() + note[1:])}.</p>' for note in found.notes),
        "<h2>Bounds</h2>",
        _checks(found),
        "<h2>Patches</h2>",
        '<div class="two">',
        f'<figure class="card">{_halves(found)}<figcaption>Each patch as rendered in the spectral mode, with the '
        "expected colour as a disc in it. A disc that cannot be seen is right.</figcaption></figure>",
        f'<figure class="card"><img alt="the chart as rendered" src="data:image/png;base64,{_base64(found.picture)}">'
        "<figcaption>The spectral mode's image itself, noise included. What lies between and below the patches is the "
        "grey card. Both are shown as an eye sees them that is used to this light.</figcaption></figure>",
        "</div>",
        _patch_table(found),
        "<h2>The light on the chart</h2>",
        f'<figure class="card">{_plot(found)}<figcaption>Spectral irradiance on the board, by the light meter and at '
        "the visible wavelengths by the grey card. The band is one standard error.</figcaption></figure>",
        "<h2>How this was measured</h2>",
        _method(found, samples),
        '<h2>Made by</h2><div class="card">',
        _versions(loaded),
        "</div>",
    ]
    head = (
        f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Calibration: {name}</title>'
    )
    body = "\n".join(parts)
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}<style>{_STYLE}</style></head>\n'
        f"<body><main>\n{body}\n</main></body></html>\n"
    )


def _place(found: Calibration) -> str:
    x, y, _ = found.point_m
    facing = "level" if found.normal == (0.0, 0.0, 1.0) else "facing " + ", ".join(f"{one:.2f}" for one in found.normal)
    return f"x {x:g} m, y {y:g} m, {found.above_ground_m:.2f} m above the ground, {facing}"


def _facts(found: Calibration) -> str:
    meter, white = found.meter, found.white
    cct = "none" if math.isnan(white.cct_k) else f"{white.cct_k:,.0f} K"
    facts = [(f"{found.delta_e(mode).mean():.2f}", f"mean ΔE 2000, {title}") for mode, title in MODES.items()]
    facts += [
        (f"{found.illuminance_lux:,.0f} lx", "illuminance of the board"),
        (cct, f"correlated colour temperature, Duv {white.duv:+.4f}"),
        (f"{100 * meter.from_sun.value:.0f}%", "of it straight from the sun"),
    ]
    return (
        '<div class="facts">'
        + "".join(f'<div class="card"><b>{a}</b><span>{b}</span></div>' for a, b in facts)
        + "</div>"
    )


def _checks(found: Calibration) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(one.name)}</td><td>{one.value:.4f}</td><td>below {one.bound:.3g}</td>"
        f"<td>{_badge(one.holds, 'holds', 'missed')}</td></tr>"
        for one in found.checks
    )
    head = "<tr><th>bound</th><th>found</th><th>asked for</th><th></th></tr>"
    return f'<div class="card"><table>{head}{rows}</table></div>'


def _badge(good: bool, yes: str, no: str) -> str:
    return f'<span class="verdict {"good" if good else "bad"}">{yes if good else no}</span>'


def _halves(found: Calibration) -> str:
    """The chart drawn: rendered squares, expected discs."""
    xy = found.white.xy
    shapes = []
    for k, patch in enumerate(found.patches):
        x, y = 10 + 46 * (k % checker.COLUMNS), 10 + 46 * (k // checker.COLUMNS)
        made, right = (_hex(checker.shown(one, xy)) for one in (patch.found_xyz["spectral"], patch.expected_xyz))
        tip = f"{html.escape(patch.name)}: ΔE {patch.delta_e['spectral']:.2f}"
        shapes.append(
            f'<g><title>{tip}</title><rect x="{x}" y="{y}" width="40" height="40" fill="{made}"/>'
            f'<circle cx="{x + 20}" cy="{y + 20}" r="11" fill="{right}"/></g>'
        )
    grey = _hex(checker.shown(_white_xyz(found) * checker.GREY, xy))
    return (
        f'<svg viewBox="0 0 290 198" role="img"><rect width="290" height="198" fill="{grey}"/>{"".join(shapes)}</svg>'
    )


def _white_xyz(found: Calibration) -> NDArray[np.float64]:
    x, y = found.white.xy
    return np.array([x / y, 1.0, (1 - x - y) / y]) * 100.0


def _patch_table(found: Calibration) -> str:
    xy = found.white.xy
    widest = max(1.0, *(float(found.delta_e(mode).max()) for mode in MODES))
    rows = []
    for k, patch in enumerate(found.patches, start=1):
        pair = "".join(
            f'<span class="swatch" style="background:{_hex(checker.shown(one, xy))}"></span>'
            for one in (patch.found_xyz["spectral"], patch.expected_xyz)
        )
        cells = "".join(f"<td>{patch.delta_e[mode]:.2f}</td>" for mode in MODES)
        width = 8 * patch.delta_e["rgb"] / widest
        rows.append(
            f'<tr><td>{k}</td><td class="left">{pair}</td><td class="left">{html.escape(patch.name)}</td>'
            f"<td>{patch.expected_xyz[1]:.2f}</td><td>{patch.found_xyz['spectral'][1]:.2f}</td>{cells}"
            f'<td class="left"><span class="bar" style="width:{width:.2f}rem"></span></td></tr>'
        )
    for word in ("mean", "max"):
        cells = "".join(f"<td><b>{getattr(found.delta_e(mode), word)():.2f}</b></td>" for mode in MODES)
        rows.append(f'<tr><td></td><td></td><td class="left"><b>{word}</b></td><td></td><td></td>{cells}<td></td></tr>')
    titles = "".join(f"<th>ΔE, {title}</th>" for title in MODES.values())
    head = '<th></th><th class="left">made, right</th><th class="left">patch</th><th>Y expected</th><th>Y made</th>'
    table = f'<table><tr>{head}{titles}<th class="left">rgb mode</th></tr>{"".join(rows)}</table>'
    return f'<div class="card" style="margin-top:1rem">{table}</div>'


def _plot(found: Calibration) -> str:
    """The light's spectrum as an inline SVG; wavelengths in their own colours below the visible part."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    spectrum, error = found.meter.spectrum, found.meter.spectrum_error
    with rc_context(
        {"svg.hashsalt": "forestgen", "font.family": "DejaVu Sans", "font.size": 10, "svg.fonttype": "path"}
    ):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        FigureCanvasSVG(figure)
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
        wavelength, value, width = spectrum.wavelength_nm, spectrum.value, error.value
        for axes, (low, high) in ((left, (300, 2500)), (right, (380, 780))):
            axes.fill_between(wavelength, value - width, value + width, color="#2c7a4b", alpha=0.25, linewidth=0)
            axes.plot(wavelength, value, color="#2c7a4b", linewidth=1.2, label="light meter")
            axes.set(xlim=(low, high), ylim=(0, None), xlabel="wavelength (nm)")
            axes.spines[["top", "right"]].set_visible(False)
        right.plot(found.light.wavelength_nm, found.light.value, ".", color="#1d2521", markersize=3, label="grey card")
        right.legend(frameon=False)
        left.set_ylabel("W m$^{-2}$ nm$^{-1}$")
        top = float(np.max(spectrum.at(np.arange(380.0, 781.0)))) * 1.1
        right.set_ylim(-0.06 * top, top)
        right.imshow(_rainbow()[None], extent=(380, 780, -0.06 * top, 0), aspect="auto", interpolation="bilinear")
        right.set_xlim(380, 780)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def _rainbow() -> NDArray[np.float64]:
    """(N, 3) sRGB of the wavelengths 380 to 780 nm, as a mark."""
    grid = np.arange(380.0, 781.0, 2.0)
    xyz = np.array([checker.xyz_of_light(_line(one)) for one in grid])
    xyz /= xyz.sum(axis=1).max()
    rgb = np.clip(checker.shown(100 * np.clip(xyz, 0, None), np.array([0.3127, 0.329])) / 255.0, 0.0, 1.0)
    return np.asarray(rgb)


def _line(centre_nm: float) -> Spectrum:
    return Spectrum(centre_nm + np.array([-3.0, 0.0, 3.0]), np.array([0.0, 1.0, 0.0]))


def _method(found: Calibration, samples: int) -> str:
    lines = (
        f'The board is flat and Lambertian, its patches have the reflectances of colour-science\'s "{checker.CHART}" '
        f"(Ohta 1997), and around them lies the grey card, which reflects {checker.GREY:.0%} at all wavelengths.",
        "The light on the board is what the grey card shows at 81 wavelengths, 380 to 780 nm: E = π L / 0.18. "
        "A perfect white surface under that light is the white of L*a*b*.",
        "The expected colour of a patch is colour-science's integration of its reflectance times that light "
        "(CIE 1931 2° observer). ΔE is CIE 2000. The light cancels; what is left is the renderer's error and noise.",
        "81 wavelengths: the patch as rendered at each of them. Spectral mode: an image of eight replicates, each of "
        "twelve wavelengths. Rgb mode: light and reflectances are linear Rec. 709 colours from the start. That is "
        "right under D65 but for colours outside of Rec. 709's gamut, and off under light of other colours, since the "
        "product of two colours is not the colour of the product.",
        f"The light meter stands at the board's middle, without the board. Card and meter must agree within "
        f"{CARD_BOUND:.0%} and three standard errors.",
        f"{samples} paths a pixel and light in each mode; the luminance of a patch is known to "
        f"{100 * max(patch.error['spectral'] for patch in found.patches):.2g}% (standard error, spectral mode).",
    )
    bounds = f"Bounds are for {' and '.join(MODES[mode] for mode in BOUND_MODES)}: mean {MEAN_BOUND}, max {MAX_BOUND}."
    return '<div class="card">' + "".join(f"<p>{line}</p>" for line in (*lines, bounds)) + "</div>"


def _versions(loaded: LoadedRecipe) -> str:
    known = package_versions()
    named = ", ".join(f"{name} {known[name]}" for name in _PACKAGES)
    return f'<p>{html.escape(named)}</p><p class="soft">recipe hash <code>{loaded.hash}</code></p>'


def _hex(code: Sequence[int] | NDArray[np.uint8]) -> str:
    return "#" + "".join(f"{int(one):02x}" for one in code)


def _enlarged(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(np.repeat(picture, 4, axis=0), 4, axis=1)


def _base64(picture: NDArray[np.uint8]) -> str:
    return base64.b64encode(_png(_enlarged(picture))).decode()


def _png(picture: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG")
    return buffer.getvalue()


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
