"""What `forestgen verify` reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from forestgen.dataset.check import CheckResult, Finding


@dataclass(frozen=True)
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
