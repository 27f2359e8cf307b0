"""Errors that tests expect. A test names the class and the place; the text is in `tests/golden/messages.txt`.

    with raises_error(RecipeError, place="site.size_m"):
        load_recipe(path)

The golden file has the id of each test, and below it the errors of the test in their order: the code, then the message.
``pytest --update-messages`` writes the messages of all tests that it runs and that pass. This module is the plugin of
pytest for that option.
"""

from __future__ import annotations

import difflib
import re
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import pytest

from forestgen.core.errors import ForestgenError

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "golden" / "messages.txt"
_OPTION = "--update-messages"
_HEAD = f"# Messages of errors, one test after the other. `pytest {_OPTION}` writes this file; see CONTRIBUTING.md.\n"
_BESIDE = r"(/popen-gw\d+)?(/[^\s/:'\"`,;()]+)?"  # a worker's folder, and that of one test

_VARIABLE_PARTS = [
    (re.compile(pattern), name)
    for pattern, name in (
        (r"\S+ on \S+, process \d+, since [\dT:.+-]+", "<user> on <host>, process <number>, since <time>"),
        (r" at 0x[0-9a-f]+>", " at <address>>"),
        (r"127\.0\.0\.1:\d{4,5}\b", "127.0.0.1:<port>"),
        (r"\b([a-z]+)-\d+-[0-9a-f]{12}\b", r"\1-<number>"),
        (r"\b(\d{6})-[0-9a-f]{40}\b", r"\1-<key>"),
        (r"\b\d+ bytes, sha256 [0-9a-f]{64}\b", "<number> bytes, sha256 <hash>"),  # images differ between processors
        (r"\.\d+\.partial\b", ".<number>.partial"),
        (r"\btime = \w{3} \w{3} [ \d]\d [\d:]{8} \d{4}\b", "time = <time>"),
        (r"\S+/forestgen-(records|log)-\w{8}\b", r"<tmp>/forestgen-\1"),
        (r"half of the [\d.,]+ [kMGT]B that are free", "half of the <memory> that are free"),
        (r"at most [\d,]+ (.*\(half of the memory that is free\))", r"at most <number> \1"),
        (r"(free disk space\n(.*\n)?  got       )[\d,]+ MB", r"\1<free> MB"),
        (r"(more memory than is free.*\n  expected  at most )[\d.,]+ [kMGT]B", r"\1<memory>"),
    )
]

Messages = dict[str, list[str]]  # id of a test -> its errors
E = TypeVar("E", bound=ForestgenError)


class _Run:
    """State of this process: the test that runs, its messages so far, and whether the golden file will have them."""

    test = ""
    seen: list[str] = []  # noqa: RUF012 - one for the process
    updates = False
    temporary = Path(tempfile.gettempdir())


@contextmanager
def raises_error(*kinds: type[E], place: str | None = None) -> Iterator[pytest.ExceptionInfo[E]]:
    """As `pytest.raises`: the block raises an error of `kinds`, with the text that the golden file has for this test.

    Parameters
    ----------
    place : the end of where the error is: the key of a recipe, a file's name, or a parameter.
    """
    __tracebackhide__ = True
    with pytest.raises(kinds) as caught:
        yield caught
    error = caught.value
    where = normalized(error.place or "")
    if place is not None and not re.search(rf"(^|[\s./:`]){re.escape(place)}$", where):
        pytest.fail(f"the error is not at {place}, but at {where or 'no place'}:\n{error}")
    compare(error.code, str(error))


def compare(code: str, text: str) -> None:
    """The next message of the running test is as in the golden file; with `--update-messages` it will be.

    Parameters
    ----------
    code : the kind of error, or the exit code of a command.
    """
    __tracebackhide__ = True
    _Run.seen.append(f"{code}: {normalized(text)}".rstrip())
    if not _Run.updates:
        found, number = _Run.seen[-1], len(_Run.seen)
        stored = _golden().get(_Run.test, [])[number - 1 : number]
        if stored != [found]:
            pytest.fail(_difference("".join(stored), found, number))


def _difference(stored: str, found: str, number: int) -> str:
    """What a person needs to judge a message that has changed."""
    lines = difflib.ndiff(stored.split("\n") if stored else [], found.split("\n"))
    return "\n".join(
        [
            f"message {number} of this test differs from {GOLDEN.relative_to(ROOT)} (- golden file, + this run).",
            f"If the new text is right: pytest {_OPTION} {shlex.quote(_Run.test)}",
            *(line for line in lines if not line.startswith("?")),
        ]
    )


def normalized(text: str) -> str:
    """A message without what differs between machines and runs: folders, processes, times, free memory."""
    for pattern, name in (*_folders(), *_VARIABLE_PARTS):
        text = pattern.sub(name, text)
    return text


@cache
def _folders() -> list[tuple[re.Pattern[str], str]]:
    """Patterns of this machine's folders, and the names that replace them."""
    folders = {str(ROOT): "<root>", sys.prefix: "<python>", sys.base_prefix: "<python>", str(Path.home()): "<home>"}
    longest_first = sorted(folders.items(), key=lambda item: -len(item[0]))
    return [
        (re.compile(re.escape(str(_Run.temporary)) + _BESIDE), "<tmp>"),
        *((re.compile(re.escape(path) + r"(?![\w-])"), name) for path, name in longest_first),
    ]


@cache
def _golden() -> Messages:
    return parsed(GOLDEN.read_text(encoding="utf-8")) if GOLDEN.exists() else {}


def parsed(text: str) -> Messages:
    """The messages of a golden file."""
    found: Messages = {}
    messages: list[str] = []
    for line in text.split("\n"):
        if re.match(r"  \S", line):
            messages.append(line[2:])
        elif not line or line.startswith("    "):
            messages[-1:] = [f"{one}\n{line[4:]}" for one in messages[-1:]]
        elif not line.startswith("#"):
            messages = found.setdefault(line, [])
    return {test: [message.rstrip("\n") for message in messages] for test, messages in found.items()}


def written(messages: Mapping[str, Sequence[str]]) -> str:
    """The text of a golden file with these messages."""
    lines = [_HEAD]
    for test in sorted(messages):
        lines.append(test)
        for message in messages[test]:
            head, *rest = message.rstrip("\n").split("\n")
            lines += [f"  {head}", *(f"    {line}" if line else "" for line in rest)]
        lines.append("")
    return "\n".join(lines)


def updated(stored: Messages, seen: Messages, collected: Iterable[str], exists: Callable[[str], bool]) -> Messages:
    """`stored` with the messages of tests that passed, and without tests that exist no more.

    Parameters
    ----------
    collected : all tests of the files that were collected whole.
    exists : whether a file of tests, named by its path below the repository, is still there.
    """
    tests = set(collected)
    files = {_file(test) for test in tests}
    kept = {
        test: messages
        for test, messages in stored.items()
        if test not in seen and exists(_file(test)) and (test in tests or _file(test) not in files)
    }
    return kept | {test: messages for test, messages in seen.items() if messages}


def _file(test: str) -> str:
    return test.partition("::")[0]


class _Update:
    """Collects the messages of a run; of one on several processes, the controller gets those of its workers."""

    def __init__(self, config: pytest.Config) -> None:
        self._output: dict[str, Any] | None = getattr(config, "workeroutput", None)
        self._whole = not any("::" in one for one in config.args) and not config.getoption("lf")
        self._collected: list[str] = []
        self._seen: Messages = {}

    @pytest.hookimpl(tryfirst=True)  # before some are left out
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        self._collected = [item.nodeid for item in items]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" and report.passed and report.nodeid == _Run.test:  # of this process
            self._seen[report.nodeid] = _Run.seen

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        output = getattr(node, "workeroutput", None) or {}  # a worker that crashed has none
        self._seen |= output.get("messages", {})
        self._collected += output.get("collected", [])

    def pytest_sessionfinish(self) -> None:
        if self._output is not None:
            self._output |= {"messages": self._seen, "collected": self._collected}
            return
        collected = self._collected if self._whole else []
        text = written(updated(_golden(), self._seen, collected, lambda file: (ROOT / file).exists()))
        GOLDEN.write_text(text, encoding="utf-8", newline="\n")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(_OPTION, action="store_true", help=f"write messages of errors to {GOLDEN.relative_to(ROOT)}")


def pytest_configure(config: pytest.Config) -> None:
    _Run.updates = config.getoption(_OPTION)
    if _Run.updates:
        config.pluginmanager.register(_Update(config))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    _Run.test = item.nodeid
    _Run.seen = []


@pytest.fixture(scope="session", autouse=True)
def _temporary_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    base = tmp_path_factory.getbasetemp()
    _Run.temporary = base.parent if base.name.startswith("popen-gw") else base
