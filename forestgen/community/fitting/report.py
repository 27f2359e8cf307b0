"""What a fit leaves behind: a recipe that places new stands, its numbers, a summary in words, and a picture."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.fitting.fit import Fit
from forestgen.community.fitting.stand import RADII, STANDS, Envelope, MeasuredStand
from forestgen.community.plots import figure_png, new_figure
from forestgen.community.population import Floats
from forestgen.core import __version__
from forestgen.core.figures import count, seconds
from forestgen.recipe.fields import NAME_PATTERN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Of each function: what it measures, its title in the picture, what joins two species, a line to compare it with.
_FUNCTIONS: dict[str, tuple[str, str, str, float | None]] = {
    "K": ("pairs", "L(r) - r (m)", " ↔ ", 0.0),
    "g": ("pair correlation", "pair correlation g(r)", " ↔ ", 1.0),
    "G": ("nearest neighbours", "G(r), nearest neighbours", " → ", None),
}
_COLOURS = ("#14532D", "#D95F02", "#4C5FB0")
_ENVELOPE, _MEAN, _STAND = "#CBD8C4", "#6B8F5E", "#B3261E"
_MIXED_SIGMA = 0.4  # radii that only serve to mix the species' order of placement
_RADIUS_OF_SPACING = 0.3
_FOUNDER, _FIRST = "-founder", 1.05  # name and radius of those that come first


def species_sources(stand: MeasuredStand, library: Mapping[str, Any] | set[str], default: str) -> dict[str, str]:
    """The recipe's names of the stand's species, and the library's species behind each.

    A species whose name the library knows is that one; all others are `default`.
    """
    if len(stand.names) == 1 and stand.names[0] not in library:
        return {default: default}
    sources: dict[str, str] = {}
    for label in stand.names:
        name = _recipe_name(label)
        while name in sources:
            name += "-2"
        sources[name] = label if label in library else default
    return sources


def _recipe_name(label: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", label).strip("-_")[:60] or "species"
    assert re.match(NAME_PATTERN, name)
    return name


def recipe_text(fit: Fit, sources: Mapping[str, str], where: str) -> str:
    """A recipe in YAML that places new stands in a window of the same size."""
    stand, counts = fit.stand, fit.kinds_count
    if fit.nursery.founders:
        ((name, source),) = sources.items()
        sources = {f"{name}{_FOUNDER}": source, name: source}
    names = list(sources)
    species = [f"{name}: {{from: {source}}}" for name, source in sources.items()]
    plants = [f"    {name}: {{count: {counts[k]}, radius_m: {_radius(fit, k)}}}" for k, name in enumerate(names)]
    per_ha = ", ".join(f"{10_000 * one / stand.area_m2:.6g}" for one in counts)
    return "\n".join(
        [
            f"# Kernels fitted to {re.sub(r'[^ -~]', '?', where)}: {stand.n} plants. forestgen {__version__} "
            f"fit-kernel, seed {fit.seed}.",
            f"# On a site of another size: plants_per_ha {per_ha} instead of count, and cells in proportion.",
            "forestgen: 1",
            f"seed: {fit.seed}",
            f"site: {{size_m: [{stand.size_m[0]:.10g}, {stand.size_m[1]:.10g}]}}",
            f"species: {{{', '.join(species)}}}",
            "community:",
            "  model: deformation_kernel",
            "  periodic: false",
            f"  cells: {fit.nursery.cells}",
            "  plants:",
            *plants,
            *_kernel_lines(fit, names),
            "",
        ]
    )


def _radius(fit: Fit, species: int) -> str:
    """Of one species without radii: a number. Of several, radii of one distribution, which mixes their order.

    Founders are larger by a little, and so come first.
    """
    stand = fit.stand
    if fit.nursery.founders:
        return f"{_RADIUS_OF_SPACING * stand.spacing_m * (_FIRST if species == 0 else 1.0):.4g}"
    if stand.radius_m is not None:
        logarithm = np.log(stand.radius_m[stand.species == species])
        sigma = float(logarithm.std())
        return f"{{median: {np.exp(logarithm.mean()):.4g}, sigma: {min(sigma, 3.0):.3g}}}"
    median = f"{_RADIUS_OF_SPACING * stand.spacing_m:.4g}"
    return median if len(stand.names) == 1 else f"{{median: {median}, sigma: {_MIXED_SIGMA}}}"


def _kernel_lines(fit: Fit, names: list[str]) -> list[str]:
    """By the species that acts and the one that is affected."""
    curves = [
        "{distance: metres, curve: [" + ", ".join(f"[{r:g}, {k:g}]" for r, k in points) + "]}"
        for points in fit.shapes.control_points(fit.matched.log_kappa)
    ]
    if len(names) == 1:
        return [f"  kernels: {curves[0]}"]
    lines = ["  kernels: # of the species that acts, on the species that is affected"]
    for j, acting in enumerate(names):
        lines.append(f"    {acting}:")
        affects = range(1 if fit.nursery.founders and j == 1 else 0, len(names))  # founders stand before all others
        lines += [f"      {names[i]}: {curves[fit.shapes.kernel_of[i, j]]}" for i in affects]
    return lines


def document(fit: Fit, where: str, notes: list[str]) -> dict[str, object]:
    """The fit's numbers, for JSON."""
    stand, names, kinds = fit.stand, fit.stand.names, fit.kinds
    return {
        "forestgen": __version__,
        "points": where,
        "seed": fit.seed,
        "n": stand.n,
        "size_m": list(stand.size_m),
        "species": [
            {"name": name, "count": len(stand.of(k)), "plants_per_ha": 10_000 * len(stand.of(k)) / stand.area_m2}
            for k, name in enumerate(names)
        ],
        "rounding_m": stand.step_m,
        "founders": fit.nursery.founders,
        "kernels": [
            {
                "affected": kinds[i],
                "acts": kinds[j],
                "symmetric": not fit.directed,
                "core_m": float(fit.shapes.core_m[k]),
                "reach_m": float(fit.shapes.knots_m[k, -1]),
                "curve": fit.shapes.control_points(fit.matched.log_kappa)[k],
            }
            for k, (i, j) in enumerate(fit.shapes.pairs)
        ],
        "new_stands_of_the_fit": fit.placed,
        "loss": fit.matched.loss,
        "loss_without_founders": fit.plain.loss,
        "largest_difference_in_deviations": float(np.abs(fit.matched.differences).max()),
        "checks": len(fit.checks),
        "checks_k_holds": fit.held("K"),
        "checks_pair_correlation_holds": fit.held("g"),
        "checks_nearest_holds": fit.held("G"),
        "checks_hold_of_its_own_stands": {name: fit.held(name, own=True) for name in "KgG"},
        "unevenness_p": fit.trend,
        "first_check": [
            {
                "function": one.name,
                "from": names[one.species[0]],
                "to": names[one.species[1]],
                **{name: getattr(one, name).tolist() for name in ("radii_m", "stand", "low", "mean", "high")},
            }
            for one in fit.checks[0]
        ],
        "notes": notes,
    }


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
        for name, (what, *_) in _FUNCTIONS.items():
            yield (
                f"{name}, {what}: within at all radii in {fit.held(name)} of {len(fit.checks)} such checks; "
                f"a fortieth new stand in {fit.held(name, own=True)}"
            )


def in_words(fit: Fit) -> str:
    """Whether new stands agree with the measured one.

    A function agrees if it stays within its envelope at all distances in half of the sets, or as often as that of one
    more new stand does: at 50 distances even such a one leaves its envelope now and then.
    """
    sets = len(fit.checks)
    enough = {name: sets / 2 if sets == 1 else min(sets / 2, fit.held(name, own=True)) for name in _FUNCTIONS}
    off = [what for name, (what, *_) in _FUNCTIONS.items() if fit.held(name) < enough[name]]
    inside = ", ".join(f"{name} ({what}) in {fit.held(name)} of {sets}" for name, (what, *_) in _FUNCTIONS.items())
    verdict = f"differ from the measured one in {' and '.join(off)}" if off else "agree with the measured one"
    more = "; a single set is severe: `checks=20` tells more" if off and sets == 1 else ""
    sort = "fresh set" if sets == 1 else "fresh sets"
    return f"new stands {verdict}: inside the envelope at all {RADII} distances are {inside} {sort}{more}"


def _verdict(one: Envelope, stand: MeasuredStand) -> str:
    whose = "the stand" if len(stand.names) == 1 else _species_of(one, stand, " to ")
    left = one.left
    if not left.any():
        return f"{one.name}(r) of {whose} lies within the envelope of {STANDS} new stands at all {RADII} radii"
    where = ", ".join(f"{r:.3g}" for r in one.radii_m[left][:6]) + (", ..." if left.sum() > 6 else "")
    inside = RADII - int(left.sum())
    return (
        f"{one.name}(r) of {whose} lies within the envelope of {STANDS} new stands at {inside} of {RADII} radii; "
        f"not at r = {where} m"
    )


def _species_of(one: Envelope, stand: MeasuredStand, joint: str) -> str:
    i, j = one.species
    return stand.names[i] if i == j else f"{stand.names[i]}{joint}{stand.names[j]}"


def fit_picture(fit: Fit, title: str) -> bytes:
    """A PNG."""
    pairs = len(fit.stand.names) * (len(fit.stand.names) + 1) // 2
    columns = max(3, pairs)
    rows = 2 if pairs == 1 else 3
    figure = new_figure(4.1 * columns, 3.9 * rows)
    grid = figure.add_gridspec(rows, columns)
    _draw_stand(figure.add_subplot(grid[0, 0]), fit.stand, fit.stand.position_m, fit.stand.species, title)
    shown = fit.example.placed_m if fit.stand.step_m == 0 else fit.example.measured_m
    _draw_stand(figure.add_subplot(grid[0, 1]), fit.stand, shown, fit.example.species, "a new stand")
    _draw_kernels(figure.add_subplot(grid[0, 2]), fit)
    shown_functions = [one for one in fit.checks[0] if one.species[0] <= one.species[1]]
    places = {name: [one for one in shown_functions if one.name == name] for name in "KgG"}
    lines = [[*places["K"], *places["g"], *places["G"]]] if pairs == 1 else [places["K"], places["G"]]
    for row, line in enumerate(lines, 1):
        for column, one in enumerate(line):
            _draw_function(figure.add_subplot(grid[row, column]), one, fit.stand)
    _legend(figure)
    return figure_png(figure)


def _legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color=_STAND, lw=1.8, label="measured stand"),
        Line2D([], [], color=_MEAN, lw=1.4, ls="--", label=f"mean of {STANDS} new stands"),
        Patch(color=_ENVELOPE, label="their envelope"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=11)


def _draw_stand(axes: Axes, stand: MeasuredStand, position_m: Floats, species: NDArray[np.int64], title: str) -> None:
    size = float(np.clip(2600 / max(len(position_m), 1), 2.0, 42.0))
    for k, name in enumerate(stand.names):
        mine = position_m[species == k]
        axes.scatter(mine[:, 0], mine[:, 1], s=size, color=_COLOURS[k], alpha=0.85, lw=0, label=name)
    axes.set(aspect="equal", xlim=(0, stand.size_m[0]), ylim=(0, stand.size_m[1]), facecolor="#FAF8F3")
    axes.set_xlabel("x (m)")
    axes.set_title(f"{title}: {len(position_m)} plants", fontsize=12)
    if len(stand.names) > 1:
        axes.legend(loc="upper right", fontsize=9, framealpha=0.9)


def _draw_kernels(axes: Axes, fit: Fit) -> None:
    """κ on a scale of octaves: a factor of two up is as far as one down."""
    least = 1 / 16
    axes.axhline(1.0, color="#999999", lw=0.8)
    styles, names = ("-", "--", ":"), fit.kinds
    curves = fit.shapes.control_points(fit.matched.log_kappa)
    for k, (points, (i, j)) in enumerate(zip(curves, fit.shapes.pairs, strict=True)):
        r, kappa = np.array(points).T
        label = names[j] if i == j else f"{names[j]} {'→' if fit.directed else '↔'} {names[i]}"
        colour = _COLOURS[i] if i == j else "#555555"
        axes.plot(r, np.maximum(kappa, least), color=colour, lw=2, ls=styles[0 if i == j else 1 + k % 2], label=label)
    axes.set_yscale("log", base=2)
    axes.set_ylim(bottom=least)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}" if value > least else "0")
    axes.set(xlabel="distance (m)", xlim=(0, fit.shapes.reach_m))
    axes.set_title("fitted kernel κ" if len(fit.shapes.pairs) == 1 else "fitted kernels κ", fontsize=12)
    if len(fit.shapes.pairs) > 1:
        axes.legend(fontsize=9, framealpha=0.9)


def _draw_function(axes: Axes, one: Envelope, stand: MeasuredStand) -> None:
    """A function of the stand and of new stands; K as L(r) - r."""
    curves = one.low, one.high, one.mean, one.stand
    if one.name == "K":
        curves = tuple(np.sqrt(k / np.pi) - one.radii_m for k in curves)  # type: ignore[assignment]
    low, high, mean, measured = curves
    _, title, arrow, level = _FUNCTIONS[one.name]
    if level is None:
        axes.set_ylim(0, 1.02)
    else:
        axes.axhline(level, color="#999999", lw=0.8)
    axes.fill_between(one.radii_m, low, high, color=_ENVELOPE, lw=0)
    axes.plot(one.radii_m, mean, color=_MEAN, lw=1.4, ls="--")
    axes.plot(one.radii_m, measured, color=_STAND, lw=1.8)
    axes.set(xlim=(0, one.radii_m[-1]), xlabel="r (m)")
    whose = (" of " if one.species[0] == one.species[1] else ": ") + _species_of(one, stand, arrow)
    axes.set_title(title + (whose if len(stand.names) > 1 else ""), fontsize=12)
