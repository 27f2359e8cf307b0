"""How much memory this process may still take."""

from __future__ import annotations

from pathlib import Path

_CGROUP = Path("/sys/fs/cgroup")  # a container sees its own limits here


def free_bytes() -> int:
    """Memory that is free on this machine, or in the container if that allows less."""
    import psutil

    machine = int(psutil.virtual_memory().available)
    container = _container_bytes(_CGROUP)
    return machine if container is None else min(machine, container)


def _container_bytes(folder: Path) -> int | None:
    """What the control group's limit leaves, None without a limit; cached files count as free."""
    try:
        limit, used = (int((folder / name).read_text()) for name in ("memory.max", "memory.current"))
        rows = (line.split() for line in (folder / "memory.stat").read_text().splitlines())
        cached = next((int(value) for name, value in rows if name == "inactive_file"), 0)
    except (OSError, ValueError):  # no control group, or "max"
        return None
    return max(0, limit - used + cached)
