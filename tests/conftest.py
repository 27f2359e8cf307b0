"""Signals as a person's terminal sets them: a job started in the background inherits them ignored.

And a cache for exemplars of the tests' own, one for bytecode, and one thread for linear algebra: tests of other
processes have the other cores, and threads that wait for one another spin meanwhile.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Before anything imports NumPy; commands that tests start inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if sys.dont_write_bytecode and "PYTEST_XDIST_WORKER" not in os.environ:
    # Where Python may keep no bytecode, each worker and command would compile all libraries anew: half of its start.
    _BYTECODE = tempfile.mkdtemp(prefix="forestgen-bytecode-")
    atexit.register(shutil.rmtree, _BYTECODE, ignore_errors=True)
    sys.pycache_prefix, sys.dont_write_bytecode = _BYTECODE, False
    os.environ["PYTHONPYCACHEPREFIX"] = _BYTECODE
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import pytest
import typer.testing
from hypothesis import settings

from forestgen.core import registry
from forestgen.core.cache import ENVIRONMENT

pytest_plugins = ["support.error_messages"]

for _number, _handler in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGTERM, signal.SIG_DFL),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(_number) == signal.SIG_IGN:
        signal.signal(_number, _handler)

# Typer builds all commands anew for each call, which takes 0.06 s, and tests make a thousand.
typer.testing._get_command = functools.cache(typer.testing._get_command)

# A first call compiles kernels, and machines are shared: the time of one example says nothing. Examples are the same in
# every run; `--hypothesis-profile explore` draws new ones.
settings.register_profile("forestgen", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile("forestgen")


@pytest.hookimpl(tryfirst=True)  # before those marked slow are left out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a product of parameters, cases that have each value once run by default; the others are slow.

    Files that need many compiled kernels come last: processes that need one at the same time would each compile it.
    """
    items.sort(key=lambda item: not item.nodeid.startswith("tests/unit/"))
    seen: dict[str, set[tuple[int, str]]] = {}
    for item in items:
        ids = getattr(getattr(item, "callspec", None), "_idlist", ())  # one for each `parametrize`
        if len(ids) < 2 or item.get_closest_marker("slow"):
            continue
        values, met = set(enumerate(ids)), seen.setdefault(item.nodeid.partition("[")[0], set())
        if values <= met:
            item.add_marker(pytest.mark.slow)
        met |= values


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """A file's tests run in one process, which builds their fixtures once; files in the order of collection.

    Processes begin at the first file, at the last and in the middle: neighbours need the same compiled kernels and
    cached plants, which two processes at a time would each make.
    """
    from xdist.scheduler import LoadFileScheduling

    class FarApart(LoadFileScheduling):
        def _assign_work_unit(self, node: Any) -> None:
            files = list(self.workqueue)
            at = (0, len(files) - 1, len(files) // 2)[int(node.gateway.id[2:]) % 3]
            self.workqueue.move_to_end(files[at], last=False)
            super()._assign_work_unit(node)

    config.option.loadscopereorder = False
    return FarApart(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Each process imports its share of the test files first: pytest rewrites a file's asserts in 0.1 s, once for all.

    Otherwise all would rewrite the same file at the same time, before any of them has stored the result.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if not worker or len(session.config.args) > 1 or not Path(session.config.args[0]).is_dir():
        return
    files = sorted(Path(session.config.args[0]).rglob("test_*.py"))
    for path in files[int(worker[2:]) :: int(os.environ["PYTEST_XDIST_WORKER_COUNT"])]:
        sys.path.insert(0, str(path.parent))
        with contextlib.suppress(Exception, pytest.skip.Exception):  # pytest reports it when it collects the file
            importlib.import_module(path.stem)


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests keep their exemplars apart from the user's; commands that they start inherit the one folder."""
    before = os.environ.get(ENVIRONMENT)
    base = tmp_path_factory.getbasetemp()
    os.environ[ENVIRONMENT] = str((base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache")
    yield
    if before is None:
        del os.environ[ENVIRONMENT]
    else:
        os.environ[ENVIRONMENT] = before


@pytest.fixture
def registries_as_before() -> Iterator[None]:
    """What a test registers or uses of other packages is forgotten."""
    from forestgen.api.catalogue import _REGISTRIES

    entries = {one: dict(one._entries) for one in _REGISTRIES.values()}
    registered = list(registry._registered)
    yield
    for one, before in entries.items():
        one._entries = before
    registry._registered[:] = registered
