"""A fit, for people: how its new stands compare with the measured one."""

from __future__ import annotations

from collections.abc import Iterator

from forestgen.community.fitting.envelopes import RADII, STANDS, Envelope
from forestgen.community.fitting.fit import Fit
from forestgen.community.fitting.stand import MeasuredStand
from forestgen.core.figures import count, seconds

_FUNCTIONS = (("K", "pairs"), ("g", "pair correlation"), ("G", "nearest neighbours"))


def head(fit: Fit) -> str:
    """What was measured, and what it took to fit it."""
    stand = fit.stand
    size = f"{stand.size_m[0]:g} x {stand.size_m[1]:g} m"
    placed = count(fit.placed, "new stand")
    return f"{count(stand.n, 'plant')} in {size}; {placed} placed for the fit, {seconds(fit.took_s)}"


def check_lines(fit: Fit) -> Iterator[str]:
    """What the checks against fresh stands found."""
    for one in fit.checks[0]:
        yield _verdict(one, fit.stand)
    if len(fit.checks) > 1:
        for name, what in _FUNCTIONS:
            yield (
                f"{name}, {what}: within at all radii in {fit.held(name)} of {len(fit.checks)} such checks; "
                f"a fortieth new stand in {fit.own_held(name)}"
            )


def in_words(fit: Fit) -> str:
    """Whether new stands agree with the measured one.

    A function agrees if it stays within its envelope at all distances in half of the sets, or as often as that of one
    more new stand does: at 50 distances even such a one leaves its envelope now and then.
    """
    sets = len(fit.checks)
    enough = {name: sets / 2 if sets == 1 else min(sets / 2, fit.own_held(name)) for name, _ in _FUNCTIONS}
    off = [what for name, what in _FUNCTIONS if fit.held(name) < enough[name]]
    inside = ", ".join(f"{name} ({what}) in {fit.held(name)} of {sets}" for name, what in _FUNCTIONS)
    verdict = f"differ from the measured one in {' and '.join(off)}" if off else "agree with the measured one"
    more = "; a single set is severe: `checks=20` tells more" if off and sets == 1 else ""
    sort = "fresh set" if sets == 1 else "fresh sets"
    return f"new stands {verdict}: inside the envelope at all {RADII} distances are {inside} {sort}{more}"


def _verdict(one: Envelope, stand: MeasuredStand) -> str:
    whose = "the stand" if len(stand.names) == 1 else _between(one, stand)
    left = one.left
    if not left.any():
        return f"{one.name}(r) of {whose} lies within the envelope of {STANDS} new stands at all {RADII} radii"
    where = ", ".join(f"{r:.3g}" for r in one.radii_m[left][:6]) + (", ..." if left.sum() > 6 else "")
    inside = RADII - int(left.sum())
    return (
        f"{one.name}(r) of {whose} lies within the envelope of {STANDS} new stands at {inside} of {RADII} radii; "
        f"not at r = {where} m"
    )


def _between(one: Envelope, stand: MeasuredStand) -> str:
    i, j = one.species
    return stand.names[i] if i == j else f"{stand.names[i]} to {stand.names[j]}"
