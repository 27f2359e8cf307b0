"""The one check command, `uv run python -m checks`: lint, types, import layers, tests; all run, then the first failure counts."""

from __future__ import annotations

import subprocess
import sys
import time

COMMANDS = (
    ("lint", ["ruff", "check", "."]),
    ("format", ["ruff", "format", "--check", "."]),
    ("types", ["mypy"]),
    ("layers", ["lint-imports", "--no-cache"]),
    ("tests", ["pytest", "-q", *sys.argv[1:]]),
)


def main() -> int:
    """Run all commands; the exit code is 1 if any failed."""
    failed = []
    for name, command in COMMANDS:
        sys.stdout.write(f"== {name}: {' '.join(command)}\n")
        sys.stdout.flush()
        start = time.perf_counter()
        code = subprocess.run([sys.executable, "-m", *command] if name != "layers" else command, check=False).returncode
        sys.stdout.write(f"== {name}: {'failed' if code else 'ok'} in {time.perf_counter() - start:.0f} s\n")
        if code:
            failed.append(name)
    if failed:
        sys.stdout.write(f"failed: {', '.join(failed)}\n")
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
