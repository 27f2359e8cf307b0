from __future__ import annotations

import pytest
from dataset_shots import make_shot


@pytest.fixture
def shot():
    return make_shot([*range(1, 13), 70_001, 2**24 - 2, 2**24 - 1])


@pytest.fixture
def wide_shot():
    return make_shot([5, 2**24 + 1, 2**31 + 7, 2**32 - 2, 2**32 - 1])
