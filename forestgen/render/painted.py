"""Mitsuba's lights and surfaces, whose channels change in place, and its path tracers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from forestgen.render.shot import Timer
from forestgen.render.surfaces import Paints, repaint
from forestgen.render.variant import BLOCK_PX, ROULETTE_DEPTH, mitsuba
from forestgen.scene.channels import RGB, Channels


class Painted:
    """The emitters and surfaces of scenes, whose channels change in place."""

    def __init__(self, timer: Timer) -> None:
        self.paints = Paints()
        self._lights: list[tuple[Any, Callable[[Channels], dict[str, Any]]]] = []
        self._timer = timer

    def light(self, recipe: Callable[[Channels], dict[str, Any]]) -> Any:
        """An emitter that is made, and later repainted, by a function of the channels; an object for one scene."""
        emitter = mitsuba().load_dict(recipe(RGB), optimize=False)
        self._lights.append((emitter, recipe))
        return emitter

    def show(self, channels: Channels) -> None:
        if channels == self.paints.channels:
            return
        mi = mitsuba()
        with self._timer("radiance: repaint"):
            self.paints.repaint(channels)
            for emitter, recipe in self._lights:
                repaint(emitter, mi.load_dict(recipe(channels), optimize=False))


def path_tracer(kind: str, max_depth: int, **more: Any) -> Any:
    settings = {"type": kind, "max_depth": max_depth, "rr_depth": ROULETTE_DEPTH, "block_size": BLOCK_PX}
    return mitsuba().load_dict(settings | more)
