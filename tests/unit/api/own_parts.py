"""A community model of another package, as a user would write one."""

from __future__ import annotations

from forestgen.community.models.uniform import MODEL as UNIFORM


class Own(type(UNIFORM)):  # type: ignore[misc]
    """Plants at random, by another name."""


MODEL = Own()


class _Incomplete:
    """Has all but one of a model's methods."""

    Parameters = UNIFORM.Parameters
    init = step = population = check_snapshot = remove = plant = expected_plants = empty_reason = estimate_bytes = None


class _Other(Own):
    """Has parameters that are none."""

    Parameters = dict


INCOMPLETE, OTHER = _Incomplete(), _Other()
