"""How far stems are from straight: a lean at the foot, bows, and leaders that nod (`recipe.wood.Sweep`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from forestgen.geometry.mesh import Floats
from forestgen.recipe.wood import Sweep

_BOWS = 6
_MOST_NODDING = 0.1  # of a tree's height


@dataclass(frozen=True)
class Bend:
    """The way aside of all that is at a height z of a tree of the height H: a lean at the foot, and bows above.

    lean fades (1 - exp(-z / fades)) + H sum_k bow_k / k sin(k pi z / H),    k = 1 to 6

    A leader that nods goes aside by nod ((z - H) / nod + 1)^2 more, above H - nod.
    """

    lean: Floats  # (2,) slopes
    fades_m: float
    bows: Floats  # (6, 2) over the height
    height_m: float
    nod: Floats  # (2,) the leader's length, to the side it nods to

    @classmethod
    def of(cls, law: Sweep, height_m: float, rng: np.random.Generator) -> Bend:
        lean = np.tan(np.radians(law.foot_deg)) * rng.normal(size=2) / np.sqrt(2.0)
        bows = law.bow * rng.normal(size=(_BOWS, 2)) / np.sqrt(2.0)
        turn = rng.uniform(0.0, 2.0 * np.pi)
        nod_m = min(law.nod_m, _MOST_NODDING * height_m)
        return cls(lean, law.fades_m, bows, height_m, nod_m * np.array([np.cos(turn), np.sin(turn)]))

    def points(self, points: Floats) -> Floats:
        """(M, 3) points, moved."""
        height_m = np.maximum(points[:, 2:], 0.0)
        share = np.minimum(height_m / self.height_m, 1.0) * np.pi
        aside = self.lean * self.fades_m * (1.0 - np.exp(-height_m / self.fades_m))
        k = np.arange(1, len(self.bows) + 1)
        aside += self.height_m * np.sin(share * k) @ (self.bows / k[:, None])
        nod_m = max(float(np.hypot(*self.nod)), 1e-9)
        aside += np.maximum((height_m - self.height_m) / nod_m + 1.0, 0.0) ** 2 * self.nod
        return np.concatenate([points[:, :2] + aside, points[:, 2:]], axis=1)
