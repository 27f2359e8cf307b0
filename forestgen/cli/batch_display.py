"""A batch's progress on standard error: bars in a terminal, and elsewhere a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from forestgen.cli.console import count
from forestgen.core.figures import three_digits
from forestgen.runs.meter import Meter

_LINE_EVERY_S = 60.0
_MOST_STAGES = 4


class Display:
    """A `runs.meter.Listener`."""

    def __init__(self) -> None:
        self.meter: Meter | None = None
        self._live: Any = None
        self._line_s = float("-inf")

    @contextmanager
    def running(self) -> Iterator[Display]:
        from rich.console import Console
        from rich.live import Live

        console = Console(stderr=True)
        if not console.is_terminal:
            yield self
            return
        with Live(console=console, refresh_per_second=2, transient=True) as self._live:
            try:
                yield self
            finally:
                self._live = None

    def say(self, text: str) -> None:
        """A line that stays."""
        if self._live is not None:
            self._live.console.print(text, markup=False, highlight=False)
        else:
            tell(text)

    def show(self, meter: Meter) -> None:
        """The counts as they are now."""
        self.meter = meter
        if self._live is not None:
            self._live.update(_bars(meter))
        elif time.monotonic() - self._line_s >= _LINE_EVERY_S:
            self._line_s = time.monotonic()
            tell(line(meter))

    def kept(self) -> str:
        """What an interrupted run leaves behind."""
        if self.meter is None:
            return "no image was made"
        total = count(self.meter.total, "image")
        done = f"{self.meter.done:,} of {total} are done and stay" if self.meter.done else f"none of {total} was done"
        return f"{done}; the same command with --resume goes on"


def line(meter: Meter) -> str:
    """The counts in a line: 120 of 1,000 images, 240 an hour, 3 h 40 min left, 2 failed; render 61 %, ..."""
    parts = [f"{meter.done:,} of {count(meter.total, 'image')}"]
    if meter.images_per_hour is not None and meter.seconds_left is not None:
        parts += [f"{three_digits(meter.images_per_hour)} an hour", f"{span(meter.seconds_left)} left"]
    else:
        parts.append(f"{span(time.monotonic() - meter.started_s)} so far")
    if meter.failed:
        parts.append(f"{meter.failed:,} failed")
    if meter.retried:
        parts.append(f"{count(meter.retried, 'attempt')} again")
    stages = _stages(meter)
    return ", ".join(parts) + (f"; {stages}" if stages else "")


def span(seconds: float) -> str:
    """A long duration for people: 40 s, 12 min, 3 h 40 min, 2 d 5 h."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 60:
        return f"{minutes} min"
    if minutes < 24 * 60:
        return f"{minutes // 60} h {minutes % 60:02d} min"
    return f"{minutes // 1440} d {minutes % 1440 // 60} h"


def _stages(meter: Meter) -> str:
    """Where the workers' time goes."""
    largest = list(meter.shares().items())[:_MOST_STAGES]
    return ", ".join(f"{name} {100 * share:.0f} %" for name, share in largest)


def _bars(meter: Meter) -> Any:
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.text import Text

    bar = ProgressBar(total=max(1, meter.total), completed=meter.done + meter.failed, width=60)
    workers = count(meter.workers, "worker") if meter.workers else "starting the workers"
    return Group(bar, Text(line(meter)), Text(f"{workers}; Ctrl-C stops, --resume goes on"))


def tell(text: str) -> None:
    """A line on standard error."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()
