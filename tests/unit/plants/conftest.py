"""Each species in turn."""

from __future__ import annotations

from typing import Any

import pytest
from plant_species import NAMES, read

from forestgen.plants.generators.silhouette import Parameters


@pytest.fixture(params=NAMES)
def species(request: pytest.FixtureRequest) -> tuple[str, Any, Parameters]:
    return (request.param, *read(request.param))
