"""What tests of whole data sets share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished data set of four images; its recipe lies beside it. Tests that change it take a copy."""
    from batch_pieces import rendered

    return rendered(tmp_path_factory)
