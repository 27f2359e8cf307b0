"""Machine code on disk is not used after a change in another file that a kernel stands on."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

HELPERS = "from forestgen.core.compiled import compiled\n\n\n@compiled\ndef helper(x):\n    return x + {added}\n"
KERNEL = """from forestgen.core.compiled import compiled
from kernels_of_a_test import numbers
from kernels_of_a_test.helpers import helper


@compiled
def kernel(x):
    return numbers.FACTOR * helper(x)
"""


def test_a_kernel_is_compiled_again_when_another_file_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "kernels_of_a_test"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "kernel.py").write_text(KERNEL)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def result(added: int, factor: int) -> tuple[int, int]:
        """The kernel's answer for 10 with these files, and how many times its machine code came from the disk."""
        for name, text in (("helpers", HELPERS.format(added=added)), ("numbers", f"FACTOR = {factor}\n")):
            path = package / f"{name}.py"
            if not path.exists() or path.read_text() != text:
                path.write_text(text)
        for name in [name for name in sys.modules if name.startswith(package.name)]:
            monkeypatch.delitem(sys.modules, name)
        importlib.invalidate_caches()
        kernel = importlib.import_module(f"{package.name}.kernel").kernel
        return kernel(10), sum(kernel.stats.cache_hits.values())

    assert result(1, 3) == (33, 0)
    assert result(1, 3) == (33, 1)
    assert result(2, 3) == (36, 0)
    assert result(2, 50) == (600, 0)
    assert result(2, 50) == (600, 1)
