"""Plants of `forestgen plant`, and allometries of tree sizes, beside measured trees of stands.

    uv run python benchmarks/tree_sizes.py [--species oak] [--plants]

For each species and class of height: the median of the measured trees; over it that of trees drawn from allometries
fitted to them; the ratio of their coefficients of variation; and two standard errors of the measured median. "Left out"
compares each study with allometries fitted to the others. `--plants` grows a plant of each class's middle height, and
compares it with the measured medians; this takes a minute for each species.
"""

from __future__ import annotations

import argparse

import numpy as np

import forestgen as fg
from support.field_trees import (
    COLUMNS,
    DRAWS,
    RELATIVES,
    Allometries,
    classes,
    field_trees,
    fitted,
    left_out,
    sizes_of,
    spread_of_median,
)


def drawn_over_measured(allometries: Allometries, trees, name: str, rng) -> str:  # type: ignore[no-untyped-def]
    """Ratio of medians, of coefficients of variation, and two standard errors of the measured median."""
    known = trees[trees[COLUMNS[name]] > 0.0]
    if len(known) < 5 or not (name == "dbh" or name in allometries.others):
        return ""
    measured = known[COLUMNS[name]].to_numpy()
    drawn = allometries.draw(np.repeat(known.height_m.to_numpy(), DRAWS), rng)[name]
    ratio = np.median(drawn) / np.median(measured)
    variation = np.std(drawn) / np.mean(drawn) / (np.std(measured) / np.mean(measured))
    error = 2.0 * spread_of_median(measured, rng)
    return f"{np.median(measured):.3g} x {ratio:.2f} cv x {variation:.2f} +-{100 * np.expm1(error):.0f}%"


def grown(species: str, height_m: float, leaf_kg: float, width_m: float) -> str:
    """Leaf mass and crown width of a plant over the measured medians."""
    plant = fg.plant(species, height_m)
    ratios = {"leaves": plant.measures.leaf_kg / leaf_kg, "width": plant.crown_width_m / width_m}
    known = [f"{name} x {ratio:.2f}" for name, ratio in ratios.items() if np.isfinite(ratio)]
    return f"plant of {height_m:.0f} m: {', '.join(known) or 'nothing was measured'}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--species", nargs="*", default=list(RELATIVES), choices=list(RELATIVES), metavar="NAME")
    parser.add_argument("--plants", action="store_true", help="grow plants too")
    arguments = parser.parse_args()
    for species in arguments.species:
        rng = np.random.default_rng(1)
        trees = field_trees(RELATIVES[species])
        tallest_m = sizes_of(species).tallest_m
        allometries = fitted(trees, tallest_m)
        studies = f"{len(trees)} trees of {trees.study.nunique()} studies"
        print(f"\n{species}: {studies}, {', '.join(RELATIVES[species])}; tallest {tallest_m:.0f} m")
        for name, allometry in {"dbh": allometries.dbh, **allometries.others}.items():
            value = np.exp(allometry.at_10_m) if name != "crown" else 1.0 / (1.0 + np.exp(-allometry.at_10_m))
            at_10_m, slope = f"{name:<6} {value:7.3f} at 10 m, exponent {allometry.exponent:5.2f}", allometry.spread[1]
            spread = f"spread {allometry.spread[0]:.2f} {slope:+.2f} ln(H/10), {allometry.trees} trees"
            print(f"  {at_10_m}, of relative dbh {allometry.relative_dbh:5.2f}, {spread}")
        for low, high, members in classes(trees):
            shown = {name: drawn_over_measured(allometries, members, name, rng) for name in COLUMNS}
            print(f"  {low:.0f}-{high:.0f} m: " + "; ".join(f"{name} {text}" for name, text in shown.items() if text))
            if arguments.plants:
                leaf_kg, width_m = members.leaf_mass_kg.median(), members.crown_width_m.median()
                print("    " + grown(species, float(members.height_m.median()), leaf_kg, width_m))
        for name in COLUMNS:
            if ratios := left_out(trees, name, tallest_m, rng):
                print(f"  left out, {name}: " + ", ".join(f"{study} {ratio:.2f}" for study, ratio in ratios.items()))


if __name__ == "__main__":
    main()
