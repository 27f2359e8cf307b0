"""A scene and the volume of its clouds, traced together: no approximation but the depth of a path."""

from __future__ import annotations

from forestgen.core.errors import RenderError
from forestgen.render.views import Shot, Timer, View


def ExactView(shot: Shot, timer: Timer) -> View:  # noqa: N802
    raise RenderError("not there yet")
