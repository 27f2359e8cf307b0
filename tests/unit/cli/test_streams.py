"""Standard streams that are closed or full, and mistakes on the command line in our words."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from forestgen.api.display import display_of
from forestgen.cli import app
from support.tiers import few

FULL = Path("/dev/full")


def shell(words: str, redirection: str, before: str = "") -> tuple[int, str, str]:
    command = f"{before}{sys.executable} -m forestgen {words} {redirection}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=120, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.skipif(not FULL.is_char_device(), reason="there is no full device")
@pytest.mark.parametrize("words", few(["models koch", "--help", "lsystem koch", "models --json", "--version"], 2))
def test_a_full_standard_output_is_told(words: str) -> None:
    code, _, err = shell(words, ">/dev/full")
    assert code == 4
    assert err.startswith("error: standard output: the ")
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("words", "redirection", "code"),
    few(
        [
            ("models koch", "<&- >&- 2>&-", 0),
            ("models nothing_of_this_name", "2>/dev/full", 2),
            ("models koch", ">&-", 0),
            ("models koch", "2>&-", 0),
            ("models nothing_of_this_name", "2>&-", 2),
        ],
        2,
    ),
)
def test_a_closed_stream_changes_no_exit_code(words: str, redirection: str, code: int) -> None:
    if "full" in redirection and not FULL.is_char_device():
        pytest.skip("there is no full device")
    assert shell(words, redirection)[0] == code


def test_progress_without_a_console(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    display = display_of(None)
    with display.running():
        display.say("to nobody")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["plant", "spruce", "--height", "6"], "Did you mean --height-m?"),
        (["completion", "bsh"], "Did you mean 'bash'?"),
        (["render", "x.yaml", "--count", "0"], "0 is not at least 1"),
        (["render", "x.yaml", "--count", "99999999999"], "is not at most 100,000,000"),
        (["render", "x.yaml", "--count", "many"], "'many' is not a whole number"),
    ],
)
def test_mistakes_are_told_in_our_words(words: list[str], told: str) -> None:
    said = CliRunner().invoke(app, words)
    assert said.exit_code == 2
    assert told in said.output
    assert "Input should" not in said.output
    assert "Value error" not in said.output


def test_a_terminal_without_unicode_shows_question_marks() -> None:
    code, out, err = shell("models strands", "", "PYTHONUTF8=0 PYTHONIOENCODING=ascii ")
    assert (code, err) == (0, "")
    assert "?" in out


def test_a_working_folder_that_is_gone_is_told(tmp_path: Path) -> None:
    recipe = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
    code, _, err = shell(f"render {recipe} -q", "", f"mkdir {tmp_path}/gone && cd {tmp_path}/gone && rmdir ../gone && ")
    assert code == 4, err
    assert "the working folder does not exist any more" in err
