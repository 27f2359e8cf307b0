"""How much memory there is, and how much this process may still take."""

from __future__ import annotations

from pathlib import Path

_CGROUP = Path("/sys/fs/cgroup")  # a container sees its own limits here


def free_bytes() -> int:
    """Memory that is free on this machine, or in the container if that allows less."""
    import psutil

    machine = int(psutil.virtual_memory().available)
    container = _container_bytes(_CGROUP)
    return machine if container is None else min(machine, container)


def whole_bytes() -> int:
    """Memory of this machine, or of the container if that allows less, whoever has taken it."""
    import psutil

    machine, container = int(psutil.virtual_memory().total), _limit_bytes(_CGROUP)
    return machine if container is None else min(machine, container)


def _limit_bytes(folder: Path) -> int | None:
    """The control group's limit, None without one."""
    try:
        return int((folder / "memory.max").read_text())
    except (OSError, ValueError):  # no control group, or "max"
        return None


def _container_bytes(folder: Path) -> int | None:
    """What the control group's limit leaves, None without a limit; cached files count as free."""
    limit = _limit_bytes(folder)
    if limit is None:
        return None
    try:
        used = int((folder / "memory.current").read_text())
        rows = (line.split() for line in (folder / "memory.stat").read_text().splitlines())
        cached = next((int(value) for name, value in rows if name == "inactive_file"), 0)
    except (OSError, ValueError):
        return None
    return max(0, limit - used + cached)
