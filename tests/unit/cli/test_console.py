"""Exit codes, signals, numbers in words."""

from __future__ import annotations

import signal
import time
from dataclasses import asdict

import pytest

from forestgen.cli.console import errors_for_people, stops_keep
from forestgen.core.errors import AssetError, ForestgenError, OutputError, RecipeError, RenderError, ResourceError
from forestgen.core.figures import count, seconds
from forestgen.runs.summary import _size_errors
from forestgen.scene.exemplars import SizeError


def test_a_width_that_no_plant_has_is_a_dash() -> None:
    errors = [asdict(SizeError("birch", 2, 1, 0.05, 0.1)), asdict(SizeError("snag", 3, 1, 0.2, None))]
    birch, snag = (line.split() for line in list(_size_errors(errors))[1:])
    assert birch[-5:] == ["5.0", "%", "10.0", "%", "-"]
    assert snag[-4:] == ["20.0", "%", "-", "-"]


def _ends(error: BaseException, capsys: pytest.CaptureFixture[str]) -> tuple[object, str]:
    with pytest.raises(SystemExit) as ended, errors_for_people():
        raise error
    out, err = capsys.readouterr()
    assert not out
    return ended.value.code, err


@pytest.mark.parametrize(
    ("kind", "code"),
    [(ForestgenError, 1), (RecipeError, 2), (AssetError, 2), (ResourceError, 3), (OutputError, 4), (RenderError, 5)],
)
def test_each_error_has_its_exit_code(
    kind: type[ForestgenError], code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    error = kind("bad value", where="a.yaml:3: seed", expected="a whole number", got="'x'", hint="remove the quotes")
    assert _ends(error, capsys) == (
        code,
        "error: a.yaml:3: seed: bad value\n"
        "  expected  a whole number\n  got       'x'\n  try       remove the quotes\n",
    )


def test_a_bug_is_called_one(capsys: pytest.CaptureFixture[str]) -> None:
    code, err = _ends(ZeroDivisionError("division by zero"), capsys)
    assert code == 70
    assert "a bug in forestgen: ZeroDivisionError: division by zero" in err
    assert "FORESTGEN_DEBUG=1" in err


def test_debugging_shows_the_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORESTGEN_DEBUG", "1")
    with pytest.raises(RecipeError), errors_for_people():
        raise RecipeError("bad value")


def test_memory_and_keyboard(capsys: pytest.CaptureFixture[str]) -> None:
    code, err = _ends(MemoryError(), capsys)
    assert code == 3
    assert err.startswith("error: memory ran out\n  try")
    assert _ends(KeyboardInterrupt(), capsys) == (130, "interrupted: nothing was written\n")


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_signals_end_the_process_with_their_code(name: str, code: int, capsys: pytest.CaptureFixture[str]) -> None:
    number = signal.Signals[name]
    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as ended, errors_for_people():
        signal.raise_signal(number)
    assert ended.value.code == code
    assert capsys.readouterr().err.endswith(": nothing was written\n")
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("converted", [True, False])
def test_a_stop_tells_what_stays_even_if_compiled_code_makes_an_error_of_it(
    converted: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException as stop:
            if converted:  # as Dr.Jit's loops do
                raise RuntimeError("an exception was encountered in the loop") from stop
            raise

    with pytest.raises(SystemExit) as ended, errors_for_people(), stops_keep(lambda: "3 images stay"):
        work()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "interrupted: 3 images stay\n"


def test_a_signal_that_the_caller_has_switched_off_stays_off() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with errors_for_people():
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def _swallow(number: signal.Signals, seen: list[str]) -> None:
    try:
        signal.raise_signal(number)
    except BaseException as error:  # noqa: BLE001 - as Numba's compiler and Dr.Jit do
        seen.append(type(error).__name__)


def _work(duration_s: float) -> None:
    end = time.monotonic() + duration_s
    while time.monotonic() < end:
        time.sleep(0.01)


def test_a_signal_that_compiled_code_swallows_comes_again(capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[str] = []

    def swallowing() -> None:
        with errors_for_people():
            _swallow(signal.SIGTERM, seen)
            _work(5.0)

    with pytest.raises(SystemExit) as ended:
        swallowing()
    assert seen == ["_StoppedError"]
    assert ended.value.code == 143
    assert "terminated" in capsys.readouterr().err
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_cleaning_up_is_not_disturbed(capsys: pytest.CaptureFixture[str]) -> None:
    cleaned = []

    def cleaning() -> None:
        with errors_for_people():
            try:
                signal.raise_signal(signal.SIGINT)
            finally:
                signal.raise_signal(signal.SIGINT)  # an impatient user
                _work(0.6)  # more than the timer's period
                cleaned.append(True)

    with pytest.raises(SystemExit) as ended:
        cleaning()
    assert cleaned
    assert ended.value.code == 130
    assert capsys.readouterr().err == "interrupted: nothing was written\n"


def test_an_import_cut_short_is_no_bug(capsys: pytest.CaptureFixture[str]) -> None:
    def importing() -> None:
        with errors_for_people():
            _swallow(signal.SIGINT, [])
            raise NameError("_drjit_ext")

    with pytest.raises(SystemExit) as ended:
        importing()
    assert ended.value.code == 130
    assert "interrupted" in capsys.readouterr().err


def test_words() -> None:
    assert (count(1, "image"), count(1200, "image"), count(0, "step")) == ("1 image", "1,200 images", "0 steps")
    durations = {0.041: "0.041 s", 9.96: "10 s", 40: "40 s", 59.96: "1 min 00 s", 61: "1 min 01 s", 3725: "1 h 02 min"}
    durations |= {13_200: "3 h 40 min", 86_399.7: "1 d 00 h", 190_800: "2 d 05 h"}
    assert {value: seconds(value) for value in durations} == durations
