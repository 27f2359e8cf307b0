"""How much work kernels ask for: refused before it is begun where it would take minutes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from forestgen.community.model import Site
from forestgen.community.placement.kernels import KernelSection, KernelTable, table
from forestgen.core.errors import RecipeError
from forestgen.recipe.sources import Keys, dotted


@dataclass(frozen=True)
class KernelWork:
    """What the kernels of a recipe cost, and the one that costs most."""

    total: float = 0.0
    most: float = 0.0
    keys: Keys = ()  # of that kernel within community.kernels
    reach_m: float = 0.0
    plants: float = 0.0  # that act by it

    def refuse_over(self, most: float, expected: str, got: str, hint: str) -> None:
        """Raise `RecipeError` for more than `most`, at the kernel that costs most."""
        if self.total > most:
            raise RecipeError(
                f"this would take too long: plants act by this kernel at up to {self.reach_m:.3g} m",
                where=dotted(("community", "kernels", *self.keys)),
                expected=f"at most {most:.0e} {expected}",
                got=f"{self.total:.1e}: {got}",
                hint=f"a shorter reach, {hint}",
            )


def kernel_work(
    kernels: object, site: Site, acting: Mapping[str, tuple[float, float]], affected: Mapping[str, float]
) -> KernelWork:
    """Sum over plants that act and what they affect within reach.

    Parameters
    ----------
    acting : by species: number of plants, and their radius in metres.
    affected : by species: what there is of it on the whole site, such as cells or plants.
    """
    made: dict[KernelSection, KernelTable] = {}
    total, most = 0.0, KernelWork()
    for actor, (plants, radius_m) in acting.items():
        for other, there in affected.items():
            found = _effect(kernels, actor, other)
            if found is None or plants * there == 0.0:
                continue
            keys, section = found
            if section not in made:
                made[section] = table(section)
            kernel = made[section]
            reach_m = 0.0 if kernel.is_neutral else float(kernel.reach_m(radius_m))
            cost = plants * there * min(1.0, math.pi * reach_m**2 / site.area_m2)
            total += cost
            if cost > most.most:
                most = KernelWork(total, cost, keys, reach_m, plants)
    return KernelWork(total, most.most, most.keys, most.reach_m, most.plants)


def _effect(kernels: object, acting: str, affected: str) -> tuple[Keys, KernelSection] | None:
    """The kernel of one species on another, and its keys; None: there is none, which is neutral."""
    if isinstance(kernels, KernelSection):
        return (), kernels
    row = kernels.get(acting) if isinstance(kernels, Mapping) else None
    if isinstance(row, KernelSection):
        return (acting,), row
    return ((acting, affected), row[affected]) if row is not None and affected in row else None
