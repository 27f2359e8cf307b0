"""`python -m forestgen` and the installed command."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line; a Ctrl-C that comes before its own handling of signals is met here."""
    try:
        from forestgen.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.stderr.write("interrupted: nothing was written\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
