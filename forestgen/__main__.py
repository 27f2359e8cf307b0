"""`python -m forestgen` and the installed command."""

from __future__ import annotations

import signal
import sys
from types import FrameType

from forestgen.core.processes import open_streams


def _stop_before_work(_number: int, _frame: FrameType | None) -> None:
    """Ctrl-C before a command handles signals itself: Typer would end without a word."""
    sys.stderr.write("interrupted: nothing was written\n")
    raise SystemExit(130)


def main() -> None:
    """Run the command line."""
    open_streams()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # ignored under nohup, and then it stays so
        signal.signal(signal.SIGINT, _stop_before_work)
    from forestgen.cli import main as run

    run()


if __name__ == "__main__":
    main()
