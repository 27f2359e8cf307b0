"""The examples of docs/lsystem.md print what the page says."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from forestgen.cli import app

PAGE = (Path(__file__).parents[3] / "docs" / "lsystem.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(lsys|console)\n(.*?)```", PAGE, re.DOTALL)


def commands() -> list[tuple[str, str]]:
    """Each command of the page, and what it prints there."""
    found = []
    for kind, text in BLOCKS:
        if kind == "console":
            for command in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
                line, _, printed = command.partition("\n")
                found.append((line, printed))
    return found


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for kind, text in BLOCKS:
        name = re.match(r"// (\w+\.lsys)\n", text)
        if kind == "lsys" and name:
            (tmp_path / name[1]).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("programs")
@pytest.mark.parametrize(("line", "printed"), commands())
def test_example(line: str, printed: str) -> None:
    if "forestgen lsystem" not in line or "|" in line:
        pytest.skip("not an L-system's command")
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        app(shlex.split(line)[1:], standalone_mode=False)
    assert out.getvalue().strip() == printed.strip()


def test_the_page_has_examples() -> None:
    assert len(commands()) > 10
