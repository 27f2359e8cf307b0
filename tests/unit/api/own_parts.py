"""A community model of another package, as a user would write one."""

from __future__ import annotations

from forestgen.community.models.uniform import MODEL as UNIFORM


class Own(type(UNIFORM)):  # type: ignore[misc]
    """Plants at random, by another name."""


MODEL = Own()
