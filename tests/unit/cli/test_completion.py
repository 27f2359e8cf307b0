"""Completion of commands, options and shipped names, as the shells ask for it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

PROGRAM = [sys.executable, "-m", "forestgen"]


def completed(*words: str) -> list[str]:
    asked = {"_FORESTGEN_COMPLETE": "complete_bash", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    done = subprocess.run(PROGRAM, env={**os.environ, **asked}, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_commands_options_and_names() -> None:
    assert {"render", "report"} <= set(completed("forestgen", "re")) <= {"render", "report", "resume"}
    assert "--overwrite" in completed("forestgen", "render", "--")
    assert completed("forestgen", "plant", "spru") == ["spruce"]
    assert "multiset_lsystem" in completed("forestgen", "models", "mult")
    assert completed("forestgen", "completion", "z") == ["zsh"]
    assert completed("forestgen", "render", "rec") == []  # a file: the shell completes it


@pytest.mark.parametrize(("shell", "check"), [("bash", "-n"), ("zsh", "-n"), ("fish", "--no-execute")])
def test_scripts(shell: str, check: str) -> None:
    done = subprocess.run([*PROGRAM, "completion", shell], capture_output=True, text=True, check=True)
    assert "_FORESTGEN_COMPLETE=complete_" + shell in done.stdout
    if shutil.which(shell):
        subprocess.run([shell, check], input=done.stdout, text=True, check=True)


def test_another_shell_is_refused() -> None:
    done = subprocess.run([*PROGRAM, "completion", "tcsh"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "bash" in done.stderr
