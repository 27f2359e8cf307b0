from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from recipe_example import RECIPE, SPECIES


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes a recipe (and its species file) and gives its path; `swap` replaces one text in the example."""

    def _write(text: str = RECIPE, *swap: tuple[str, str], species: str = SPECIES) -> Path:
        for old, new in swap:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "oak.yaml").write_text(species)
        path = tmp_path / "stand.yaml"
        path.write_text(text)
        return path

    return _write
