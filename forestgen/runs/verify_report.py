"""What `forestgen verify` reports."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from forestgen.core.figures import count, seconds
from forestgen.dataset.check import CheckResult, Finding


@dataclass(frozen=True, repr=False)
class VerificationReport:
    """What the checks found."""

    images: int
    frames: int
    files: int  # that SHA256SUMS lists
    checks: tuple[CheckResult, ...]  # in their order; `images` counts what a check looked at
    findings: tuple[Finding, ...]  # in the order of the checks; of each check the first thousand
    notes: tuple[str, ...]  # for people; none of them is an error
    seconds: float

    @property
    def ok(self) -> bool:
        """Whether every check passed."""
        return not self.findings

    @property
    def not_named(self) -> int:
        """How many findings there are beyond those in `findings`."""
        return sum(check.found for check in self.checks) - len(self.findings)

    def as_dict(self) -> dict[str, Any]:
        """The report in plain types, for JSON."""
        return {
            "ok": self.ok,
            "images": self.images,
            "frames": self.frames,
            "files": self.files,
            "checks": [
                {"name": one.name, "holds": one.holds, "looked_at": one.images, "findings": one.found}
                for one in self.checks
            ],
            "findings": [_finding(one) for one in self.findings],
            "findings_not_named": self.not_named,
            "notes": list(self.notes),
            "seconds": round(self.seconds, 3),
        }

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        found = "ok" if self.ok else count(len(self.findings) + self.not_named, "finding")
        return f"<VerificationReport: {found}, {count(self.images, 'image')}, {count(self.frames, 'frame')}>"

    def lines(self) -> Iterator[str]:
        """For people: the table of checks, what was found, then what they should know."""
        width = max(len(check.name) for check in self.checks)
        yield f"{'check':<{width}}   looked at  ok"
        for check in self.checks:
            what = f"FAILED: {check.holds} ({count(check.found, 'finding')})" if check.found else check.holds
            mark = "no " if check.found else "yes"
            yield f"{check.name:<{width}}  {check.images:>10,}  {mark} {what}"
        for one in self.findings:
            values = [f"{word} {text}" for word, text in (("expected", one.expected), ("got", one.got)) if text]
            more = f" ({'; '.join(values)})" if values else ""
            yield f"{one.check}: {one.where}: {one.problem}{more}"
        if self.not_named:
            yield f"... and {self.not_named:,} more"
        for note in self.notes:
            yield f"note: {note}"
        done = f"{count(self.images, 'image')}, {count(self.frames, 'frame')}, {count(self.files, 'file')}"
        yield f"{done} in {seconds(self.seconds)}"


def _finding(one: Finding) -> dict[str, Any]:
    return {
        "check": one.check,
        "where": one.where,
        "problem": one.problem,
        "expected": one.expected,
        "got": one.got,
        "file": one.file,
        "frame": one.image or None,
        "plant_id": one.plant_id,
        "pixel": None if one.pixel is None else list(one.pixel),
    }
