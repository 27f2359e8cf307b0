"""The generated pages say what the code says."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

GENERATE = Path(__file__).parents[3] / "docs" / "generate.py"


def _pages() -> dict[Path, str]:
    spec = importlib.util.spec_from_file_location("docs_generate", GENERATE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(GENERATE.parent))  # generate.py imports the module beside it
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(GENERATE.parent))
    return dict(module.pages())


PAGES = _pages()


@pytest.mark.parametrize("path", sorted(PAGES), ids=lambda path: path.name)
def test_page_is_up_to_date(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == PAGES[path], "run `uv run python docs/generate.py`"
