"""Files and functions stay short enough to read at once. Compiled kernels are left out: a call in a loop costs time."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import forestgen

MOST_LINES_OF_A_FILE = 450
MOST_LINES_OF_A_FUNCTION = 60
KERNELS = {"compiled", "fma_njit", "inlined", "unchecked"}  # the decorators of `core.compiled`


def too_long(path: Path) -> Iterator[str]:
    text = path.read_text(encoding="utf-8")
    if (lines := text.count("\n")) > MOST_LINES_OF_A_FILE:
        yield f"{path}: {lines} lines"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno is not None:
            lines = node.end_lineno - node.lineno + 1
            is_kernel = any(isinstance(one, ast.Name) and one.id in KERNELS for one in node.decorator_list)
            if lines > MOST_LINES_OF_A_FUNCTION and not is_kernel:
                yield f"{path}:{node.lineno}: {node.name} has {lines} lines"


def test_no_file_and_no_function_is_long() -> None:
    package = Path(forestgen.__file__).parent
    assert [one for path in sorted(package.rglob("*.py")) for one in too_long(path)] == []


def test_long_ones_are_found_and_kernels_are_not(tmp_path: Path) -> None:
    body = "\n".join(["    pass"] * MOST_LINES_OF_A_FUNCTION)
    path = tmp_path / "long.py"
    path.write_text(f"@compiled\ndef kernel():\n{body}\n\n\n@other\ndef function():\n{body}\n")
    assert list(too_long(path)) == [f"{path}:66: function has 61 lines"]
    path.write_text("\n" * 451)
    assert list(too_long(path)) == [f"{path}: 451 lines"]
