"""The command line as a user meets it, in this process or in one of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from typer.testing import CliRunner

from forestgen.api import display
from forestgen.cli import app
from support.error_messages import compare

CAMERAS = "cameras: [{position_m: [3, -3, 1.5], look_at_m: [3, 3, 0.5], size_px: [48, 27]}]"
# Wet soil is drawn in a tenth of the time of litter, leaf by leaf.
TINY = """\
forestgen: 1
seed: 3
site: {size_m: [6, 5], terrain: flat, ground: soil_wet}
species: {fireweed: }
community: {model: multiset_lsystem, program: succession, steps: 12}
plants: {exemplars_per_species: 2}
{CAMERAS}
render: {samples: 1, denoise: false}
labels: {samples: 1}
""".replace("{CAMERAS}", CAMERAS)


@dataclass(frozen=True)
class Answer:
    """What a command did."""

    code: int
    out: str
    err: str

    def refused(self, code: int, *parts: str) -> None:
        """Assert a clear message of that exit code, as the golden file has it, and nothing else.

        Several errors of one recipe come together, and their number at the end.

        Parameters
        ----------
        parts : of a message that depends on the machine; it is not compared with the golden file.
        """
        assert self.code == code, self.err
        assert self.err.startswith("error: ")
        errors = self.err.count("error: ")
        assert errors == 1 or self.err.rstrip().endswith(f"\n{errors} errors"), self.err
        assert "Traceback" not in self.err + self.out
        assert "a bug in forestgen" not in self.err
        assert not self.out
        for part in parts:
            assert part in self.err, f"{part!r} is not in: {self.err}"
        if not parts:
            compare(str(code), self.err.removeprefix("error: "))


def run(*arguments: str | Path) -> Answer:
    """A command in this process. However busy the machine is, no line tells meanwhile how far it has come."""
    with patch.object(display, "_LINE_EVERY_S", 3600.0):
        result = CliRunner().invoke(app, [str(one) for one in arguments], prog_name="forestgen")
    return Answer(result.exit_code, result.stdout, result.stderr)


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "forestgen", *(str(one) for one in arguments)]


def start(*arguments: str | Path, cwd: Path | None = None) -> subprocess.Popen[str]:
    """A command in a process of its own, which Ctrl-C reaches even if the tests run in the background of a shell."""
    return subprocess.Popen(
        command(*arguments),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env={name: value for name, value in os.environ.items() if name != "FORESTGEN_DEBUG"},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL) and None,
    )


def wait_for_handler(process: subprocess.Popen[str], number: signal.Signals) -> None:
    """Until the process has its own handling of a signal; before, Python itself is still starting and dies silently.

    A process that ends meanwhile is left for the caller to judge.
    """
    status = Path(f"/proc/{process.pid}/status")
    if not status.exists():  # no Linux: as long as a start takes
        time.sleep(1.0)
        return
    while process.poll() is None:
        caught = next((line for line in status.read_text().splitlines() if line.startswith("SigCgt:")), "SigCgt: 0")
        if int(caught.split()[1], 16) >> (number - 1) & 1:
            return
        time.sleep(0.01)


def tiny(folder: Path, *swaps: tuple[str, str]) -> Path:
    """A small recipe in `folder`, with texts replaced."""
    text = TINY
    for old, new in swaps:
        assert old in text
        text = text.replace(old, new)
    path = folder / "tiny.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def tree(folder: Path) -> dict[str, bytes | None]:
    """Everything in a folder, hidden files too: name -> bytes, None for a folder."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }
