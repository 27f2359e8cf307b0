"""Progress: bars in a terminal, lines in a log, one changing line in a notebook, nothing where it is not wanted."""

from __future__ import annotations

import io
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from forestgen.api import display
from forestgen.api.display import Bars, Lines, NotebookDisplay, SilentDisplay, display_of
from forestgen.runs.summary import ProgressTracker


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def _shown(stream: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> str:
    """What the display that suits a stream writes there of three pieces of work."""
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    bars = display_of(None)
    with bars.running():
        for title, total in (("community", 100_001), ("identity camera0", 16_384), ("community", 100_001)):
            with bars.stage(title, total) as advance:
                advance(total)
    return stream.getvalue()


def test_bars_on_a_terminal_fit_and_are_reused(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = _shown(_Terminal(), monkeypatch)
    last = shown.rsplit("community", 1)[1]
    assert "100001/100001" in last
    assert "identity camera0" in last
    assert "16384/16384" in last


def test_no_bars_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _shown(io.StringIO(), monkeypatch) == ""  # quick work needs no line either


def test_many_stages_do_not_grow_off_the_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", _Terminal())
    bars = Bars()
    with bars.running() as running:
        for number in range(100):
            with bars.stage(f"radiance {number}", 1) as advance:
                advance(1)
        assert len(running._progress.tasks) <= 12


def test_bars_show_the_images_of_a_run_and_lines_that_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = _Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERM", "xterm")
    bars, meter = Bars(), ProgressTracker(40, already=7, failed=1)
    with bars.running():
        bars.show(meter)
        bars.say("writing [the files]")  # brackets are no markup
    assert "8/40" in stream.getvalue()
    assert "1 failed" in stream.getvalue()
    assert "writing [the files]" in stream.getvalue()
    assert bars.tracker is meter
    with bars.stage("later", 3) as advance:  # outside of a block nothing is shown
        advance(1)


def _wait_for(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.005)


def test_lines_come_at_every_interval_while_the_work_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    lines, meter, seen = Lines(every_s=0.02), ProgressTracker(10), ""

    def come(number: int) -> bool:
        nonlocal seen
        seen += capsys.readouterr().err
        return seen.count("\n") >= number

    with lines.running():
        time.sleep(0.1)
        assert capsys.readouterr().err == ""  # nothing has begun
        lines.show(meter)
        with lines.stage("community", 200) as outer, lines.stage("radiance", 50) as inner:
            outer(10)
            inner(10)
            inner(15)
            _wait_for(lambda: come(3))
    assert set(seen.splitlines()) == {"0 of 10 images, 0 s so far; radiance 50 %"}
    assert "forestgen progress" not in [one.name for one in threading.enumerate()]
    assert capsys.readouterr().out == ""


def test_a_line_names_the_run_the_innermost_stage_or_both() -> None:
    lines = Lines()
    assert lines.line() == ""
    with lines.stage("community", 0):  # of no steps
        assert lines.line() == "community 0 %"
        lines.show(ProgressTracker(1))
        assert lines.line() == "0 of 1 image, 0 s so far; community 0 %"
    assert lines.line() == "0 of 1 image, 0 s so far"


def test_lines_stop_when_the_work_fails() -> None:
    lines = Lines(every_s=60.0)
    started = time.monotonic()
    with pytest.raises(ZeroDivisionError), lines.running():
        raise ZeroDivisionError
    assert time.monotonic() - started < 10.0  # the thread does not wait for its minute
    assert "forestgen progress" not in [one.name for one in threading.enumerate()]


def test_silence_is_silent(capfd: pytest.CaptureFixture[str]) -> None:
    silent, meter = display_of(False), ProgressTracker(3)
    assert type(silent) is SilentDisplay
    with silent.running(), silent.stage("community", 3) as advance:
        advance(1)
        silent.say("a note")
        silent.show(meter)
    assert capfd.readouterr() == ("", "")
    assert silent.tracker is meter  # an interrupted command tells what is done


class _Listener:
    """What a caller may hand over: stages alone."""

    def __init__(self) -> None:
        self.heard: list[tuple[str, int]] = []

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Callable[[int], None]]:
        yield lambda steps: self.heard.append((title, steps))


def test_the_display_is_that_of_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", _Terminal())
    assert [type(display_of(one)) for one in (None, True, False)] == [Bars, Bars, SilentDisplay]
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert [type(display_of(one)) for one in (None, True, False)] == [Lines, Lines, SilentDisplay]
    own = Lines()
    assert display_of(own) is own
    listener = _Listener()
    wrapped = display_of(listener)
    with wrapped.running(), wrapped.stage("community", 3) as advance:
        advance(2)
    wrapped.say("not heard")
    assert listener.heard == [("community", 2)]
    listener.running = True  # type: ignore[attr-defined]  # an attribute of this name makes no display
    with display_of(listener).running() as shown:
        shown.say("not heard")
    monkeypatch.setattr(display, "_in_notebook", lambda: True)
    assert type(display_of(None)) is NotebookDisplay


def test_short_blocks_of_one_display_make_one_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the frames of an iteration do, each of which has a block."""
    told: list[str] = []
    lines = Lines(every_s=0.05)
    monkeypatch.setattr(lines, "_tell", told.append)
    lines.show(ProgressTracker(10))
    until = time.monotonic() + 10.0
    while len(told) < 2:
        assert time.monotonic() < until
        with lines.running():
            time.sleep(0.01)


def test_a_notebook_has_one_line_for_all_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    outputs: list[list[str]] = []

    class Handle:
        def update(self, text: object) -> None:
            outputs[-1].append(repr(text))

    def shown(text: object, *, display_id: bool) -> Handle:
        outputs.append([repr(text)])
        return Handle()

    pretty = type("Pretty", (), {"__init__": lambda self, data: setattr(self, "data", data)})
    module = types.ModuleType("IPython.display")
    vars(module).update(Pretty=pretty, display=shown)
    monkeypatch.setitem(sys.modules, "IPython", types.ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    notebook = NotebookDisplay()
    for _ in range(3):
        with notebook.running():
            notebook._tell("at work")
    assert outputs == [["at work", "done"] * 3]
