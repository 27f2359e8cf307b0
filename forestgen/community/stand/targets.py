"""What a forester knows of a storey: keys of a recipe, and the number and diameters of stems that follow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from scipy.special import gamma, ndtr, ndtri

from forestgen.community.population import Ecologies, Floats, Indices, SpeciesEcology
from forestgen.community.stand.spacing import LEAST_R, MOST_R
from forestgen.community.stand.tree_list import TALLEST_M
from forestgen.core.compiled import compiled
from forestgen.core.errors import RecipeError
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.recipe.fields import Name, NonNegative, Number, Positive, Section, violation
from forestgen.recipe.tree_sizes import NUMBERS, TOP, TreeSizes

_MOST_STEMS_PER_HA, _MOST_AREA = 1e6, 300.0  # the area in m² per hectare
TOLERANCE = 0.05  # of a target that others determine
THICKEST_PER_HA = 100  # whose mean height is the dominant height
INDEX_AGE_YR = 100
_QUANTILES = 1000
_LEAST_TOP_M = 1.5
_SCATTER = 1.15  # of heights at one diameter: two standard deviations
_SMALLEST = 0.2  # diameter of a normal distribution's thinnest tree over the mean
_CURVES = {  # asymptote in metres, b, c: see `dominant_height_at`
    "spruce": (147.481, 4.64631, 0.29981),
    "pine": (128.229, 4.70248, 0.47692),
}


class Dbh(Section):
    """Diameters at breast height of a storey."""

    mean_cm: Positive | None = Field(None, le=500, description="Arithmetic mean; null: by the other targets.")
    cv: NonNegative = Field(0.25, le=1, description="Standard deviation over the mean.")
    law: Literal["weibull", "normal"] = Field(
        "weibull", description="Two-parameter Weibull; or normal, cut at a fifth of the mean; its cv is below 0.8."
    )

    def relative(self, uniform: Floats) -> Floats:
        """Diameters over their mean, of numbers in [0, 1)."""
        if self.cv == 0:
            return np.ones(len(uniform))
        if self.law == "normal":
            cut, scale = _cut_normal(self.cv)
            least = ndtr(cut)
            return np.asarray(_SMALLEST + scale * (ndtri(np.maximum(least + (1.0 - least) * uniform, 1e-300)) - cut))
        shape = _weibull_shape(self.cv)
        return np.asarray((-np.log1p(-uniform)) ** (1.0 / shape) / gamma(1.0 + 1.0 / shape))


def _cut_normal(cv: float) -> tuple[float, float]:
    """Where a standard normal distribution is cut below, and its scale: the rest, from `_SMALLEST` on, has mean 1 and
    this coefficient of variation.
    """
    from scipy.optimize import brentq  # slow to import

    def scale(cut: float) -> tuple[float, float]:
        """The scale for the mean, and the standard deviation that follows."""
        ahead = np.exp(-(cut**2) / 2) / np.sqrt(2 * np.pi) / ndtr(-cut)  # mean of a standard normal number beyond it
        factor = (1.0 - _SMALLEST) / (ahead - cut)
        return factor, factor * np.sqrt(1.0 + cut * ahead - ahead**2)

    low, high = -(1.0 - _SMALLEST) / max(cv, 1e-4), 5.0
    spread = min(cv, scale(high)[1])
    cut = brentq(lambda one: scale(one)[1] - spread, 1.5 * low, high)
    return float(cut), float(scale(cut)[0])


def _weibull_shape(cv: float) -> float:
    """The shape at which a Weibull distribution has a coefficient of variation."""
    from scipy.optimize import brentq  # slow to import

    def excess(shape: float) -> float:
        return float(gamma(1 + 2 / shape) / gamma(1 + 1 / shape) ** 2 - 1 - cv**2)

    return float(brentq(excess, 0.5, 200.0)) if cv > 0.007 else 200.0


class Storey(Section):
    """Trees of about one height."""

    species: dict[Name, Positive] = Field(min_length=1, description="Share of each species, of any sum.")
    share_of: Literal["basal_area", "stems"] = Field("basal_area", description="What the shares are of.")
    stems_per_ha: Positive | None = Field(None, le=_MOST_STEMS_PER_HA, description="Number of stems per hectare.")
    basal_area_m2_per_ha: Positive | None = Field(
        None, le=_MOST_AREA, description="Area of all stems at 1.3 m, per hectare."
    )
    dbh: Annotated[Dbh, BeforeValidator(lambda value: {} if value is None else value)] = Field(
        Dbh.model_validate({}), description="Diameters at breast height: mean_cm, cv, law."
    )
    dominant_height_m: Positive | None = Field(
        None,
        gt=_LEAST_TOP_M,
        le=TALLEST_M,
        description="Mean height of this storey's 100 thickest trees per hectare.",
    )
    age_yr: Positive | None = Field(None, le=2000, description="Age of the trees; with site_index_m it gives a height.")
    site_index_m: Positive | None = Field(
        None, gt=1.5, le=60, description="Dominant height at 100 years, instead of dominant_height_m."
    )
    height_curve: Literal["spruce", "pine"] = Field("spruce", description="Curve of height over age.")
    clark_evans: Number = Field(
        1.0, ge=LEAST_R, le=MOST_R, description="Pattern of stems: below 1 clumped, 1 random, above 1 regular."
    )

    @model_validator(mode="after")
    def _is_determined(self) -> Self:
        numbers = (self.stems_per_ha, self.basal_area_m2_per_ha)
        if numbers == (None, None):
            raise violation("stems_per_ha, basal_area_m2_per_ha or both", problem="how many trees?")
        if self.site_index_m is not None and (self.age_yr is None or self.dominant_height_m is not None):
            problem = "site_index_m gives the dominant height at an age"
            raise violation("age_yr with site_index_m, or dominant_height_m", problem=problem, at="site_index_m")
        if self.site_index_m is not None and not _LEAST_TOP_M < (top := self.top_height_m or 0.0) <= TALLEST_M:
            problem = f"at this age trees of site index {self.site_index_m:g} m are no stand that can be built"
            expected = f"an age at which they are {_LEAST_TOP_M:g} to {TALLEST_M:g} m tall"
            raise violation(expected, problem=problem, got=f"{self.age_yr:g} years: {top:.2g} m", at="age_yr")
        if self.by_height and self.top_height_m is None:
            expected = "dbh.mean_cm, a dominant height, or both stems_per_ha and basal_area_m2_per_ha"
            raise violation(expected, problem="how large are the trees?")
        return self

    @property
    def by_height(self) -> bool:
        """Whether the dominant height determines the diameters."""
        return self.dbh.mean_cm is None and None in (self.stems_per_ha, self.basal_area_m2_per_ha)

    @property
    def top_height_m(self) -> float | None:
        """The dominant height that is asked for."""
        if self.site_index_m is None or self.age_yr is None:
            return self.dominant_height_m
        return dominant_height_at(self.age_yr, self.site_index_m, self.height_curve)


def dominant_height_at(age_yr: float, site_index_m: float, curve: str) -> float:
    """Dominant height, metres, at an age by site index curves, of Norway spruce or Scots pine in natural stands.

    H(t) = A (H100 / A)^exp(b / t^c - b / 100^c). Reference: Gustavsen 1980, Site index curves for conifer stands in
    Finland, Folia Forestalia 454.
    """
    most, b, c = _CURVES[curve]
    return float(most * (site_index_m / most) ** math.exp(min(b * (age_yr**-c - INDEX_AGE_YR**-c), 700.0)))


@dataclass(frozen=True)
class Stocking:
    """How many stems a storey has, and their mean diameter."""

    stems_per_ha: float
    mean_dbh_m: float
    basal_area_m2_per_ha: float


def stocking(storey: Storey, species: Ecologies, where: str) -> Stocking:
    """Numbers that the targets determine. Raises `RecipeError`: they contradict each other."""
    square = float(np.mean(storey.dbh.relative(_middles(_QUANTILES)) ** 2))  # mean of (D / mean D)²
    per_stem = 0.25 * math.pi * square
    stems, area = storey.stems_per_ha, storey.basal_area_m2_per_ha
    mean = None if storey.dbh.mean_cm is None else storey.dbh.mean_cm / 100.0
    if stems is not None and area is not None:
        fitting = math.sqrt(area / (stems * per_stem))
        if mean is not None and abs(stems * per_stem * mean**2 / area - 1.0) > TOLERANCE:
            problem = "stems_per_ha, basal_area_m2_per_ha and dbh.mean_cm contradict each other"
            fits = stems * per_stem * mean**2, area / (per_stem * mean**2), 100 * fitting
            expected = "a basal area of {:.3g} m²/ha, or {:.4g} stems/ha, or a mean of {:.3g} cm".format(*fits)
            got = f"{area:g} m²/ha, {stems:g} stems/ha, {100 * mean:g} cm with cv {storey.dbh.cv:g}"
            raise RecipeError(problem, where=where, expected=expected, got=got, hint="leave one of the three out")
        mean = fitting
    elif mean is None:
        mean = _mean_by_height(storey, species, per_stem, where)
    if stems is None:
        assert area is not None
        stems = area / (per_stem * mean**2)
    found = Stocking(stems, mean, stems * per_stem * mean**2)
    _check_stocking(found, storey, where)
    return found


def _check_stocking(found: Stocking, storey: Storey, where: str) -> None:
    """Raise `RecipeError` for numbers beyond those that a recipe may ask for, with the targets that lead to them."""
    given = [name for name in ("stems_per_ha", "basal_area_m2_per_ha") if getattr(storey, name) is not None]
    targets = " and ".join([*given, "a dominant height" if storey.by_height else "dbh.mean_cm"])
    got = f"{found.stems_per_ha:,.0f} stems/ha of {100 * found.mean_dbh_m:.3g} cm in the mean, "
    got += f"{found.basal_area_m2_per_ha:,.4g} m²/ha"
    for name, most, hint in (
        ("stems_per_ha", _MOST_STEMS_PER_HA, "a smaller basal area, or thicker trees"),
        ("basal_area_m2_per_ha", _MOST_AREA, "fewer stems, or thinner trees"),
    ):
        if getattr(found, name) > most * (1 + 1e-9):
            problem, expected = f"{targets} lead to too high a {name}", f"{name} of at most {most:,.0f}"
            raise RecipeError(problem, where=where, expected=expected, got=got, hint=hint)


def _mean_by_height(storey: Storey, species: Ecologies, per_stem: float, where: str) -> float:
    """The mean diameter, metres, at which the thickest trees have the dominant height by their allometry."""
    top = storey.top_height_m
    assert top is not None
    relative = np.sort(storey.dbh.relative(_middles(_QUANTILES)))[::-1]
    stems, mean = storey.stems_per_ha or 500.0, 0.2
    known_m = np.geomspace(1e-4, 50.0, _QUANTILES)
    heights_m = _mean_heights_m(storey, species, known_m)
    if top > TOP * heights_m[-1]:
        problem, expected = "trees of these species are not so tall", f"at most {TOP * heights_m[-1]:.3g} m"
        hint = "give stems_per_ha and a dbh too; or raise tree.tallest_m in the species' files"
        raise RecipeError(problem, where=where, expected=expected, got=f"a dominant height of {top:.3g} m", hint=hint)
    for _ in range(10):
        tall = relative[: max(1, round(_QUANTILES * min(1.0, THICKEST_PER_HA / stems)))]
        low, high = 0.005, 5.0
        for _ in range(40):
            mean = math.sqrt(low * high)
            height = float(np.interp(mean * tall, known_m, heights_m).mean())
            low, high = (mean, high) if height < top else (low, mean)
        if storey.stems_per_ha is not None or storey.basal_area_m2_per_ha is None:
            break
        stems = storey.basal_area_m2_per_ha / (per_stem * mean**2)
    return mean


def _mean_heights_m(storey: Storey, species: Ecologies, dbh_m: Floats) -> Floats:
    """(N,) heights of trees of (N,) diameters, the mean of the storey's species by their shares."""
    none = np.zeros((len(dbh_m), NUMBERS))
    heights = [share * laws_of(species, name).height_of(dbh_m, none) for name, share in storey.species.items()]
    return np.asarray(sum(heights)) / sum(storey.species.values())


def height_range_m(storey: Storey, species: Ecologies, where: str) -> tuple[float, float]:
    """Least and greatest height, metres, of nearly all trees of a storey."""
    found = stocking(storey, species, where)
    thick = 1.0 - 0.5 * min(1.0, THICKEST_PER_HA / found.stems_per_ha)  # in the middle of the thickest
    dbh_m = found.mean_dbh_m * storey.dbh.relative(np.array([0.01, thick, 0.99]))
    low, dominant, high = (_mean_heights_m(storey, species, dbh_m) - BREAST_HEIGHT_M).tolist()
    scale = 1.0 if storey.top_height_m is None else (storey.top_height_m - BREAST_HEIGHT_M) / dominant
    return BREAST_HEIGHT_M + scale * low / _SCATTER, BREAST_HEIGHT_M + scale * high * _SCATTER


def laws_of(species: Ecologies, name: str) -> TreeSizes:
    """The sizes of a species' trees; `check_trees` has been through it."""
    law = next(one.tree for one in species if one.name == name)
    assert law is not None
    return law


def _middles(n: int) -> Floats:
    return (np.arange(n) + 0.5) / n


def diameters_m(storey: Storey, found: Stocking, area_ha: float, rng: np.random.Generator) -> Floats:
    """(N,) diameters of the storey's trees on a site, the thickest first: exactly of the basal area or of the mean."""
    n = round(found.stems_per_ha * area_ha)
    if n == 0:
        return np.zeros(0)
    relative = np.sort(storey.dbh.relative((np.arange(n) + rng.random(n)) / n))[::-1]
    if storey.basal_area_m2_per_ha is None:
        return np.asarray(np.maximum(relative * (found.mean_dbh_m / relative.mean()), 0.005))
    scale = math.sqrt(storey.basal_area_m2_per_ha * area_ha / (0.25 * math.pi * float(np.sum(relative**2))))
    return np.asarray(np.maximum(scale * relative, 0.005))


def species_of(storey: Storey, dbh_m: Floats, species: Ecologies, rng: np.random.Generator) -> Indices:
    """(N,) index of each tree's species, of the shares asked for to within a tree.

    A species that tolerates more shade than the others has more of the thin trees: the odds change by a factor of
    e^(2 Δtolerance) from the thickest to the thinnest.
    """
    index = {one.name: i for i, one in enumerate(species)}
    chosen = [index[name] for name in storey.species]
    shares = np.array(list(storey.species.values()))
    shares = shares / shares.sum()
    tolerance = np.array([species[i].shade_tolerance for i in chosen])
    size = dbh_m**2 if storey.share_of == "basal_area" else np.ones(len(dbh_m))
    rank = (np.arange(len(dbh_m)) + 0.5) / max(len(dbh_m), 1)  # 0: the thickest
    odds = np.exp(2.0 * np.outer(rank - 0.5, tolerance - tolerance @ shares)) * shares
    for _ in range(20 if len(chosen) > 1 else 0):
        odds /= odds.sum(axis=1, keepdims=True)
        odds *= shares / np.maximum(size @ odds / size.sum(), 1e-300) if len(size) else 1.0
    odds /= odds.sum(axis=1, keepdims=True)
    label = np.zeros(len(dbh_m), dtype=np.int64)
    _diffuse(odds, size, rng.permutation(len(dbh_m)), label)
    return np.array(chosen, dtype=np.int64)[label]


@compiled
def _diffuse(odds, size, order, label):  # type: ignore[no-untyped-def]
    """Give each tree, in an order, to the species that is owed most; `odds` (N, S) and `size` (N,) make it due."""
    owed = np.zeros(odds.shape[1])
    for row in order:
        owed += odds[row] * size[row]
        label[row] = np.argmax(owed)
        owed[label[row]] -= size[row]


def check_trees(storey: Storey, species: Ecologies, where: str) -> None:
    """Raise `RecipeError` for a species whose trees have no sizes."""
    for name in storey.species:
        one: SpeciesEcology | None = next((one for one in species if one.name == name), None)
        if one is not None and one.tree is None:
            able = ", ".join(one.name for one in species if one.tree is not None) or "none of this recipe"
            problem, expected = f"{name} is no tree: its species has no section `tree`", f"trees: {able}"
            hint = "put herbs and shrubs into community.ground"
            raise RecipeError(problem, where=f"{where}.species.{name}", expected=expected, got=name, hint=hint)
