"""The generated pages say what the code says."""

from __future__ import annotations

import functools
import importlib.util
import sys
from pathlib import Path

GENERATE = Path(__file__).parents[3] / "docs" / "generate.py"


@functools.cache
def pages() -> dict[Path, str]:
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


def test_pages_are_up_to_date() -> None:
    old = [path.name for path, text in pages().items() if path.read_text(encoding="utf-8") != text]
    assert not old, "run `uv run python docs/generate.py`"
