"""What makes finished images stale."""

from __future__ import annotations

import re

from forestgen.core.cache import source_files
from forestgen.runs.records import _SOURCES, _WITHOUT


def test_the_words_of_summaries_are_no_part_of_an_images_key() -> None:
    """Results that print themselves line by line shape no image."""
    printed = re.compile(r"def lines\(self.*\) -> Iterator\[str\]")
    every = [path for path in source_files(_SOURCES) if printed.search(path.read_text())]
    of_index = {"stand_table.py", "instrument.py"}  # whose figures stand in the index
    every = [path for path in every if path.name not in of_index]
    assert {path.name for path in every} == {"point_statistics.py", "summary.py"}  # others lie in uncounted packages
    assert not set(every) & set(source_files(_SOURCES, _WITHOUT))
