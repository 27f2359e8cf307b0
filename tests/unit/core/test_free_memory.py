from __future__ import annotations

from pathlib import Path

import psutil
import pytest

from forestgen.core import processes as memory


def _group(folder: Path, limit: str) -> None:
    (folder / "memory.max").write_text(limit + "\n")
    (folder / "memory.current").write_text("3000\n")
    (folder / "memory.stat").write_text("anon 2000\ninactive_file 500\n")


@pytest.mark.parametrize(("limit", "free"), [("4000", 1500), ("2000", 0)])
def test_a_containers_limit_counts(limit: str, free: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _group(tmp_path, limit)
    monkeypatch.setattr(memory, "_CGROUP", tmp_path)
    assert memory.free_bytes() == free
    assert memory.whole_bytes() == int(limit)


@pytest.mark.parametrize("limit", ["max", str(10**18), None])
def test_without_a_limit_the_machine_counts(limit: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if limit:
        _group(tmp_path, limit)
    monkeypatch.setattr(memory, "_CGROUP", tmp_path)
    machine = psutil.virtual_memory()
    monkeypatch.setattr(psutil, "virtual_memory", lambda: machine)
    assert memory.free_bytes() == machine.available
    assert memory.whole_bytes() == machine.total
