"""What a kept result depends on besides its inputs."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from forestgen.core import cache as module
from forestgen.core.registry import Registration

PARTS = ("core", "plants", "pipeline.py")


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for layer in ("core", "plants", "labels"):
        (tmp_path / layer / "deep").mkdir(parents=True)
        (tmp_path / layer / "deep" / "a.py").write_text("x = 1")
    (tmp_path / "pipeline.py").write_text("x = 1")
    monkeypatch.setattr(module, "PACKAGE", tmp_path)
    return tmp_path


def now(*tables: Path) -> str:
    return module._code_hash.__wrapped__(PARTS, ("numpy",), tables, (), ())


def test_every_change_of_the_code_counts(package: Path) -> None:
    seen = {now()}
    for path, text in (
        ("plants/deep/a.py", "x = 2"),
        ("core/b.lark", "y"),
        ("pipeline.py", "x = 2"),
        ("core/c.py", ""),
    ):
        (package / path).write_text(text)
        seen.add(now())
    (package / "core" / "c.py").rename(package / "core" / "d.py")
    seen.add(now())
    (package / "core" / "d.py").unlink()
    assert len(seen) == 6
    assert now() in seen


def test_other_layers_and_what_is_compiled_do_not(package: Path) -> None:
    before = now()
    (package / "labels" / "deep" / "a.py").write_text("x = 2")
    (package / "plants" / "__pycache__").mkdir()
    (package / "plants" / "__pycache__" / "kernel.nbi").write_text("compiled")
    assert now() == before


def test_what_is_left_out_does_not_count(package: Path) -> None:
    def hashed() -> str:
        return module._code_hash.__wrapped__(PARTS, (), (), ("plants/deep", "core/a.py"), ())

    (package / "core" / "a.py").write_text("x = 1")
    before = hashed()
    (package / "core" / "a.py").write_text("x = 2")
    (package / "plants" / "deep" / "a.py").write_text("x = 2")
    assert hashed() == before
    (package / "core" / "ab.py").write_text("x = 2")
    assert hashed() != before


def test_text_that_moves_between_files_counts(package: Path) -> None:
    (package / "core" / "deep" / "a.py").write_text("x = 1\ny = 2")
    before = now()
    (package / "core" / "deep" / "a.py").write_text("x = 1")
    (package / "core" / "deep" / "b.py").write_text("y = 2")
    assert now() != before


def test_tables_and_versions_count(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tables = package / "tables"
    tables.mkdir()
    (tables / "leaf.csv").write_text("400,0.1")
    seen = {now(), now(tables)}
    (tables / "leaf.csv").write_text("400,0.2")
    seen.add(now(tables))
    monkeypatch.setattr(module, "version", lambda name: "99")
    seen.add(now(tables))
    assert len(seen) == 4


def test_parts_of_other_packages_count(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def hashed(*registered: Registration) -> str:
        return module._code_hash.__wrapped__(PARTS, (), (), (), registered)

    own = package / "own_model_of_a_test.py"
    own.write_text("MODEL = 1")
    monkeypatch.syspath_prepend(package)
    part = Registration("community model", "own", "own_model_of_a_test:MODEL", "")
    seen = {hashed(), hashed(part), hashed(replace(part, name="other"))}
    own.write_text("MODEL = 2")
    seen.add(hashed(part))
    assert len(seen) == 4


def test_every_user_of_it_names_parts_that_exist() -> None:
    from forestgen.atmosphere import simulate
    from forestgen.community import simulation
    from forestgen.plants import growing
    from forestgen.render import rendering
    from forestgen.runs import records as keys

    root = module.PACKAGE
    for parts in (simulate.SOURCES, *(one._SOURCES for one in (keys, growing, rendering, simulation))):
        assert all((root / part).exists() for part in parts)
        assert module.source_files(parts)


def test_jobs_are_known_by_all_code_that_makes_their_files() -> None:
    """What a batch's key counts, and what a worker calls, imports nothing of forestgen's that it does not count."""
    from forestgen.runs import records as keys

    root = module.PACKAGE
    counted = set(module.source_files(keys._SOURCES, keys._WITHOUT))
    left_out = set(module.source_files(keys._SOURCES)) - counted
    assert all((root / one).exists() for one in keys._WITHOUT)
    counted_code = {one for one in counted if one.suffix == ".py"} - {root / "__init__.py"}  # see below
    for path in (root / "runs" / "work.py", *counted_code):
        for imported in imports_of(path, root) - counted:
            if (path, imported) == (root / "pipeline.py", root / "community" / "summary.py"):
                continue  # what a simulation prints, which is in no frame's files
            assert path.name == "work.py", (path, imported)
            assert imported not in left_out
            assert imported.parent == root / "runs"


def test_the_package_itself_imports_nothing() -> None:
    """Its names come from modules that are imported when they are first asked for."""
    code = "import forestgen, sys; print([name for name in sys.modules if name.startswith('forestgen.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def imports_of(path: Path, root: Path) -> set[Path]:
    """Files of forestgen's modules that a file imports, at its top or inside functions.

    But for those of the checks of a format, which `verify` calls and no worker, and for those of types alone.
    """
    found = set()
    for node in imports_in(ast.parse(path.read_text(encoding="utf-8"))):
        if node.module and node.module.partition(".")[0] == "forestgen":
            for name in (node.module, *(f"{node.module}.{one.name}" for one in node.names)):
                place = root.joinpath(*name.split(".")[1:])
                found |= {one for one in (place.with_suffix(".py"), place / "__init__.py") if one.exists()}
    return found


def imports_in(node: ast.AST) -> Iterator[ast.ImportFrom]:
    for inner in ast.iter_child_nodes(node):
        of_types = isinstance(inner, ast.If) and ast.unparse(inner.test) == "TYPE_CHECKING"
        of_checks = isinstance(inner, ast.FunctionDef) and inner.name in ("frame_checks", "dataset_checks")
        if isinstance(inner, ast.ImportFrom):
            yield inner
        elif not of_types and not of_checks:
            yield from imports_in(inner)
