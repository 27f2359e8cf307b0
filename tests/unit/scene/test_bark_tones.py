"""Tones of wood: by plant, and of mean 1."""

from __future__ import annotations

import numpy as np

from forestgen.scene.bark_tones import SPREAD, bark_tones


def test_tones_have_the_mean_one_and_belong_to_the_plant() -> None:
    ids = np.arange(1, 40_001, dtype=np.uint32)
    tone = bark_tones(ids, SPREAD)
    assert abs(float(tone.mean()) - 1.0) < 4.0 * SPREAD / 200.0
    assert np.isclose(tone.std(), SPREAD, rtol=0.02)
    assert tone.min() > 0.3
    assert np.array_equal(bark_tones(ids[::-1], SPREAD), tone[::-1])
    nameless = bark_tones(np.zeros(100, np.uint32), SPREAD)
    assert len(np.unique(nameless)) == 100
