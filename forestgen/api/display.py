"""Progress for people: bars in a terminal, a line that changes in a notebook, a line a minute elsewhere.

All of it goes to standard error, or to the notebook's cell; results never do.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, cast

from forestgen.core.arguments import shown
from forestgen.core.errors import RecipeError
from forestgen.core.figures import seconds, three_digits
from forestgen.core.progress import Progress
from forestgen.runs.summary import Display, ProgressTracker, SilentDisplay

_LINE_EVERY_S = 60.0
_NOTEBOOK_EVERY_S = 0.5
_MOST_BARS = 12  # more would not fit into a terminal's usual height
_MOST_STAGES = 4


def display_of(progress: bool | Progress | None) -> Display:
    """The display that a call's argument `progress` asks for.

    Parameters
    ----------
    progress : None or True: what suits the place, a terminal, a notebook or a log; False: nothing; or an object with
        a method ``stage(title, total)``, a context manager that yields a function that advances.
    """
    if progress is False:
        return SilentDisplay()
    if progress is None or progress is True:
        if _in_notebook():
            return NotebookDisplay()
        is_terminal = sys.stderr is not None and not sys.stderr.closed and sys.stderr.isatty()
        return Bars() if is_terminal else Lines(_LINE_EVERY_S)
    if not callable(getattr(progress, "stage", None)) or isinstance(progress, type):
        expected = "None, True, False, or an object with a method stage(title, total)"
        raise RecipeError("this shows no progress", parameter="progress", expected=expected, got=shown(progress))
    is_display = all(callable(getattr(progress, name, None)) for name in ("running", "say", "show"))
    return cast(Display, progress) if is_display else _Wrapped(progress)


class _Wrapped(SilentDisplay):
    """Hands the stages on to a listener of the caller's."""

    def __init__(self, listener: Progress) -> None:
        self.stage = listener.stage  # type: ignore[method-assign,assignment]


class Bars(SilentDisplay):
    """Bars with the time left, in a terminal."""

    def __init__(self) -> None:
        self._progress: Any = None
        self._tasks: dict[str, Any] = {}  # by title, oldest first
        self._run: Any = None

    @contextmanager
    def running(self) -> Iterator[Bars]:
        from rich import progress as bars
        from rich.console import Console

        columns = (
            bars.TextColumn("{task.description:<18}", markup=False),
            bars.BarColumn(bar_width=24),
            bars.MofNCompleteColumn(),
            bars.TimeElapsedColumn(),
            bars.TextColumn("left"),
            bars.TimeRemainingColumn(),
            bars.TextColumn("{task.fields[note]}", markup=False),
        )
        with bars.Progress(*columns, console=Console(stderr=True), refresh_per_second=5, transient=True) as shown:
            self._progress = shown
            try:
                yield self
            finally:
                self._progress, self._run = None, None
                self._tasks.clear()

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Callable[[int], None]]:
        """A bar for one piece of work; the next image's work of the same title takes the same bar."""
        shown = self._progress
        if shown is None:
            yield lambda steps: None
            return
        if title in self._tasks:
            task = self._tasks[title]
            shown.reset(task, total=total)
        else:
            task = self._tasks[title] = shown.add_task(title, total=total, note="")
            finished = {one.id for one in shown.tasks if one.finished}
            oldest = next((name for name, one in self._tasks.items() if one in finished), None)
            if len(self._tasks) > _MOST_BARS and oldest is not None:
                shown.remove_task(self._tasks.pop(oldest))
        try:
            yield lambda steps: shown.advance(task, steps)
        finally:
            shown.stop_task(task)

    def say(self, text: str) -> None:
        if self._progress is not None:
            self._progress.console.print(text, markup=False, highlight=False)
        else:
            _write(text)

    def show(self, tracker: ProgressTracker) -> None:
        self.tracker = tracker
        if self._progress is None:
            return
        if self._run is None:
            self._run = self._progress.add_task("images", total=tracker.total, note="")
        self._progress.update(self._run, completed=tracker.done + tracker.failed, note=pace(tracker))


class Lines(SilentDisplay):
    """A line a minute on standard error: how far the run is, and the stage in work.

    The minutes go on from one block of `running` to the next: those of an iteration over frames are short.
    """

    def __init__(self, every_s: float = _LINE_EVERY_S) -> None:
        self._every_s = every_s
        self._next_s = math.inf  # monotonic time of the next line
        self._stages: list[_Stage] = []  # in work, the innermost last

    @contextmanager
    def running(self) -> Iterator[Lines]:
        stop = threading.Event()
        self._next_s = min(self._next_s, time.monotonic() + self._every_s)

        def write() -> None:
            while not stop.wait(max(self._next_s - time.monotonic(), 0.0)):
                self._next_s = time.monotonic() + self._every_s
                if text := self.line():
                    self._tell(text)

        thread = threading.Thread(target=write, name="forestgen progress", daemon=True)
        thread.start()
        try:
            yield self
        finally:
            stop.set()
            thread.join()

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Callable[[int], None]]:
        one = _Stage(title, total)
        self._stages.append(one)
        try:
            yield one.advance
        finally:
            self._stages.remove(one)

    def line(self) -> str:
        """How far it is; "" if nothing has begun."""
        parts = [line(self.tracker)] if self.tracker is not None else []
        stages = list(self._stages)
        return "; ".join([*parts, *([stages[-1].text] if stages else [])])

    def say(self, text: str) -> None:
        _write(text)

    _tell = say


class NotebookDisplay(Lines):
    """One line under the cell that changes, the same in all blocks of `running`."""

    def __init__(self) -> None:
        super().__init__(_NOTEBOOK_EVERY_S)
        self._handle: Any = None

    def _tell(self, text: str) -> None:
        from IPython.display import Pretty, display

        class Line(Pretty):  # type: ignore[misc]
            def __repr__(self) -> str:
                return str(self.data)

        if self._handle is None:
            self._handle = display(Line(text), display_id=True)
        else:
            self._handle.update(Line(text))

    @contextmanager
    def running(self) -> Iterator[NotebookDisplay]:
        with super().running():
            yield self
        if self._handle is not None:
            self._tell(self.line() or "done")


class _Stage:
    """A piece of work and how much of it is done."""

    def __init__(self, title: str, total: int) -> None:
        self._title, self._total, self._done = title, total, 0

    def advance(self, steps: int) -> None:
        self._done += steps

    @property
    def text(self) -> str:
        return f"{self._title} {100 * self._done / max(self._total, 1):.0f} %"


def line(tracker: ProgressTracker) -> str:
    """The counts in a line: 120 of 1,000 images, 240 an hour, 3 h 40 min left, 2 failed; render 61 %, ..."""
    images = f"{tracker.total:,} image{'' if tracker.total == 1 else 's'}"
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in list(tracker.shares().items())[:_MOST_STAGES])
    return f"{tracker.done:,} of {images}, {pace(tracker)}" + (f"; {shares}" if shares else "")


def pace(tracker: ProgressTracker) -> str:
    """How fast a run is, and what went wrong."""
    parts = []
    if tracker.images_per_hour is not None and tracker.seconds_left is not None:
        parts += [f"{three_digits(tracker.images_per_hour)} an hour", f"{seconds(round(tracker.seconds_left))} left"]
    else:
        parts.append(f"{seconds(round(time.monotonic() - tracker.started_s))} so far")
    if tracker.failed:
        parts.append(f"{tracker.failed:,} failed")
    if tracker.retried:
        parts.append(f"{tracker.retried:,} attempt{'' if tracker.retried == 1 else 's'} again")
    return ", ".join(parts)


def _in_notebook() -> bool:
    """Whether this is a Jupyter kernel, where a cell shows what is displayed."""
    if "IPython" not in sys.modules:
        return False
    shell = sys.modules["IPython"].get_ipython()
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"


def _write(text: str) -> None:
    if sys.stderr is None:  # of a program without a console
        return
    with suppress(OSError, ValueError):  # it is full, or closed: the work goes on
        sys.stderr.write(text + "\n")
        sys.stderr.flush()
