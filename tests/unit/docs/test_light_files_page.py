"""The way of reading light that the docs show runs, and says what is in the file."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.core.spectrum import Band, Spectrum
from forestgen.dataset.exr import light_attributes, own_attributes, radiance_channels, write_parts
from forestgen.render.frame import Radiance

DOCS = Path(__file__).parents[3] / "docs"
SNIPPETS = [
    snippet
    for page in sorted(DOCS.glob("*.md"))
    for snippet in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    if "whiteLuminance" in snippet
]
LIGHT = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32) * 9000
COLOUR = Radiance(LIGHT, LIGHT / 100, None, 32)


def bands() -> tuple[Band, ...]:
    return tuple(
        Band(f"B{k}", Spectrum(np.array([k - 5.0, k, k + 5.0]), np.array([0.0, 1, 0]))) for k in (490, 560, 840)
    )


@pytest.mark.parametrize("spectral", [False, True])
def test_the_snippet_prints_what_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str], spectral: bool) -> None:
    radiance = replace(COLOUR, channels=("B490", "B560", "B840"), bands=bands()) if spectral else COLOUR
    parts = radiance_channels(radiance)
    header = {f"forestgen/{name}": text for name, text in light_attributes(radiance, dict.fromkeys(parts)).items()}
    write_parts(tmp_path / "frame.exr", parts, header, own_attributes(radiance))
    [snippet] = SNIPPETS
    names = {"path": str(tmp_path / "frame.exr")}
    exec(snippet, names)
    told = capsys.readouterr().out
    if spectral:
        assert told.startswith("W m-2 sr-1 nm-1 32 samples\n")
        mean = float(told.rpartition("B840 840.0 nm: ")[2])
        assert mean == pytest.approx(LIGHT[..., 2].mean(), rel=1e-5)
    else:
        assert told.startswith("cd/m2, linear Rec. 709 (D65) 32 samples\n")
        luminance = LIGHT.astype(float) @ [0.2126, 0.7152, 0.0722]
        assert float(told.split()[-2]) == pytest.approx(luminance.mean(), rel=1e-5)
