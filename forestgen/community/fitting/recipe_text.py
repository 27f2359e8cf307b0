"""What a fit leaves behind: a recipe that places new stands, and its numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from forestgen.community.fitting.fit import Fit
from forestgen.community.fitting.stand import MeasuredStand
from forestgen.core import __version__
from forestgen.recipe.fields import NAME_PATTERN

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
        "loss": fit.matched.losses[-1],
        "loss_without_founders": fit.plain.losses[-1],
        "largest_difference_in_deviations": float(np.abs(fit.matched.differences).max()),
        "checks": len(fit.checks),
        "checks_k_holds": fit.held("K"),
        "checks_pair_correlation_holds": fit.held("g"),
        "checks_nearest_holds": fit.held("G"),
        "checks_hold_of_its_own_stands": {name: fit.own_held(name) for name in "KgG"},
        "unevenness_p": fit.trend,
        "first_check": [
            {
                "function": one.name,
                "from": names[one.species[0]],
                "to": names[one.species[1]],
                "radii_m": one.radii_m.tolist(),
                "stand": one.stand.tolist(),
                "low": one.low.tolist(),
                "mean": one.mean.tolist(),
                "high": one.high.tolist(),
            }
            for one in fit.checks[0]
        ],
        "notes": notes,
    }
