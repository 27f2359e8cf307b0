"""Plant communities by multiset L-systems: self-thinning and succession.

Reference: B. Lane, Models of Plant Communities for Image Synthesis, MSc thesis, University of Calgary, 2002, sections
4.2 to 4.4 (first published as B. Lane and P. Prusinkiewicz, Generating spatial distributions for multilevel models of
plant communities, Graphics Interface 2002).

Each plant is a word ``T(x, r, sp) ?E(c)`` of a multiset: a circle of radius r around x, of species sp. After each
derivation step the environment (`forestgen.community.environment`) sets c to 0 where the circle intersects a larger
one (the plant is dominated) and to 1 elsewhere. In the next step each word is rewritten by the first production that
matches; then successors are cut at every fragmentation symbol % and the pieces become words of their own.

``program: self_thinning`` is L-system 4.4; its axiom is a cohort of `initial_plants_per_ha` words at random places::

    1.  T(x, r) ?E(c) : c == 0   ->  ε
    2.  T(x, r)       : r >= R   ->  T(x, R)
    3.  T(x, r)                  ->  T(x, r + grow(r, Δt))

``program: succession`` is L-system 4.5 for any number of species; its axiom is { X }, a bare site::

    1.  X  ->  T(x_1, r_1, sp_1) ?E(1) % ... T(x_n, r_n, sp_n) ?E(1) % X
    2.  T(x, r, sp) ?E(c) : c == 0 && random(1) < shaded[sp]  ->  T(x, r, sp) ?E(1)
    3.  T(x, r, sp) ?E(c) : c == 0                            ->  ε
    4.  T(x, r, sp)       : r >= R && random(1) < oldage[sp]  ->  T(x, R, sp)
    5.  T(x, r, sp)       : r >= R                            ->  ε
    6.  T(x, r, sp)                                           ->  T(x, r + grow(r, sp, Δt), sp)

========================  ======================  ==========  ============  ==========
parameter                 symbol                  unit        range         default
========================  ======================  ==========  ============  ==========
program                                                       the two       succession
steps                                                         0 to 100000   300
step_yr                   Δt                      yr          0 < Δt        0.5
periodic                                                                    true
initial_plants_per_ha     n                       1/ha        0 <= n        5000
growth_m_per_yr           grow / Δt               m/yr        0 <=          of species
max_radius_m              R                       m           0 <           of species
shade_tolerance           shaded                  1 (a step)  0 to 1        of species
old_age_survival          oldage                  1 (a step)  0 to 1        of species
seedlings_per_ha_per_yr   (n, m) / (area Δt)      1/(ha yr)   0 <=          of species
seedling_radius_m         mean of r_1 ... r_n     m           0 < r <= R    of species
height_m scale, exponent  A_H, c_H: H = A_H r^c_H m, 1                      of species
========================  ======================  ==========  ============  ==========

Recipe::

    community: {model: multiset_lsystem, program: succession, steps: 300, step_yr: 0.5}

Decided where the thesis is silent or contradicts itself:

- Production 4 of 4.5 reads random(1) < oldage, production 3 of 4.6 random(1) > oldage. The text decides: a mature plant
  survives a step with probability oldage.
- shaded and oldage are probabilities a step, as printed. Change step_yr and they stay: a calibration holds for its
  step_yr (the species that come with forestgen: 0.5 yr).
- A plant that is both dominated and mature is subject to productions 2 and 3, which stand first.
- grow() is linear in time and ends exactly at R. A seedling is never larger than its R.
- n and m of production 1 are Poisson numbers of mean rate x area x step_yr; places are uniform on the site; radii are
  uniform between 0.5 and 1.5 times seedling_radius_m. A seedling takes part in the environment of the step in which it
  arrives: one that falls into a larger circle is dominated at once, and lives on only by its shade tolerance.
- The cohort of 4.4 has round(n x area) plants; with several species, each is of any of them with equal probability.
- The site is by default a torus: a plant at the left edge competes with those at the right. Otherwise plants at an edge
  have fewer rivals and a small site is a biased sample. ``periodic: false`` gives the bounded site, with that edge.
- The thesis prints neither the parameters of its species nor the size of its site. Those that come with forestgen were
  chosen for 120 m x 120 m. Means of ten seeds at steps 20, 150, 300, 1000 (Table 7.1 and section 4.5 in brackets):
  2124, 1686, 1613, 1472 plants (2688, 1593, 1409, 834), H 0.87, 0.85, 0.85, 0.85 (0.6, 0.7, 0.7, 0.6). So the order of
  dominance is that of the thesis, and the first three numbers within 25%; the old stand has too many plants, three
  fifths of them herbs in gaps, and is less regular. A search over the parameters with herbs of at most 0.5 m and trees
  of at most 3.2 m found none that does much better; herbs of 0.6 to 0.8 m lowered H to 0.76 to 0.8 at some steps.
- Words have no order, so rows are kept in order of plant_id; X is no row: it is always there in 4.5, never in 4.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from forestgen.community import environment
from forestgen.community.model import Site, SpeciesEcology
from forestgen.community.population import Population, Status
from forestgen.core.errors import ResourceError
from forestgen.core.randomness import child_rng

_LARGEST_ID = 2**32 - 1
_DEFAULT_COHORT_PER_HA = 5000.0
# Peak bytes a plant: a state, its successor, the tables between them and a snapshot; then the environment's.
_BYTES_PER_PLANT = 260 + environment.BYTES_PER_CIRCLE
_BYTES_AT_LEAST = 256 * 1024


class MultisetParameters(BaseModel):
    """What a recipe says about the model besides its species."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    program: Literal["self_thinning", "succession"] = Field(
        "succession", description="L-system 4.4 (self_thinning) or 4.5 (succession) of Lane 2002"
    )
    steps: int = Field(300, ge=0, le=100_000, description="number of derivation steps")
    step_yr: float = Field(0.5, gt=0, description="duration of a derivation step, years")
    periodic: bool = Field(True, description="the site is a torus, without edges; false: a bounded site")
    initial_plants_per_ha: float | None = Field(
        None, ge=0, description="plants in the initial cohort, per hectare; self_thinning only, where it is 5000"
    )

    @model_validator(mode="after")
    def _cohort_needs_self_thinning(self) -> Self:
        if self.program == "succession" and self.initial_plants_per_ha is not None:
            raise ValueError("initial_plants_per_ha belongs to program self_thinning: succession starts on bare ground")
        return self


@dataclass(frozen=True)
class Words:
    """The multiset: a row is a word T(x, r, sp) ?E(c); rows in order of plant_id."""

    x_m: NDArray[np.float64]  # (N, 2) metres, world x and y
    r_m: NDArray[np.float64]  # (N,) metres
    sp: NDArray[np.uint16]  # (N,) index of species
    c: NDArray[np.bool_]  # (N,) False: dominated
    plant_id: NDArray[np.uint32]  # (N,)
    born: NDArray[np.int32]  # (N,) step of arrival

    def __len__(self) -> int:
        return len(self.r_m)

    def where(self, keep: NDArray[np.bool_], r_m: NDArray[np.float64]) -> Words:
        """The kept words, with new radii (given for all words)."""
        return Words(self.x_m[keep], r_m[keep], self.sp[keep], self.c[keep], self.plant_id[keep], self.born[keep])


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: MultisetParameters
    site: Site
    species: tuple[SpeciesEcology, ...]
    seed: int
    step: int  # derivation steps done
    next_id: int  # the id of the next plant to arrive
    words: Words


def _of_species(species: Sequence[SpeciesEcology], name: str) -> NDArray[np.float64]:
    return np.array([getattr(one, name) for one in species], dtype=np.float64)


def _new_words(
    sp: NDArray[np.uint16],
    site: Site,
    species: Sequence[SpeciesEcology],
    rng: np.random.Generator,
    first_id: int,
    born: int,
) -> Words:
    """Words ?E(1) of the given species at random places and of random small radii, numbered from `first_id`."""
    n = len(sp)
    _refuse_overflow(first_id, n)
    x_m = rng.random((n, 2)) * site.size_m
    r_m = _of_species(species, "seedling_radius_m")[sp] * rng.uniform(0.5, 1.5, n)
    np.minimum(r_m, _of_species(species, "max_radius_m")[sp], out=r_m)
    plant_id = np.arange(first_id, first_id + n, dtype=np.uint32)
    return Words(x_m, r_m, sp, np.ones(n, dtype=np.bool_), plant_id, np.full(n, born, dtype=np.int32))


def _refuse_overflow(first_id: int, expected: float) -> None:
    if first_id - 1 + expected > _LARGEST_ID:
        raise ResourceError(
            "plant ids are used up",
            expected=f"at most {_LARGEST_ID} plants in the history of a community",
            got=f"{first_id - 1} plants so far and about {expected:.3g} more",
            hint="lower seedlings_per_ha_per_yr (or initial_plants_per_ha), steps or site.size_m",
        )


def _seedlings_per_step(
    parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]
) -> NDArray[np.float64]:
    """Mean of production 1's n, m, ...; (number of species,)."""
    with np.errstate(over="ignore"):  # inf is refused like any other absurd number
        return _of_species(species, "seedlings_per_ha_per_yr") * site.area_ha * parameters.step_yr


def successor_of_x(state: State, rng: np.random.Generator) -> Words:
    """Production 1 of L-system 4.5: the modules between the % of X's successor, each a word once it is cut."""
    mean = _seedlings_per_step(state.parameters, state.site, state.species)
    _refuse_overflow(state.next_id, float(mean.sum()))
    sp = np.repeat(np.arange(len(state.species), dtype=np.uint16), rng.poisson(mean))
    return _new_words(sp, state.site, state.species, rng, state.next_id, state.step + 1)


def rewrite(state: State, u: NDArray[np.float64]) -> Words:
    """The other productions: words that survive, with their new radii.

    `u` is random(1) of each word, (N,); one number serves, for no word meets two conditions that draw.
    """
    words, species = state.words, state.species
    largest = _of_species(species, "max_radius_m")[words.sp]
    mature = words.c & (words.r_m >= largest)
    grown = np.minimum(
        words.r_m + (_of_species(species, "growth_m_per_yr") * state.parameters.step_yr)[words.sp], largest
    )
    r_m = np.where(words.c, grown, words.r_m)
    if state.parameters.program == "self_thinning":
        return words.where(words.c, r_m)
    survives_shade = ~words.c & (u < _of_species(species, "shade_tolerance")[words.sp])
    survives_age = mature & (u < _of_species(species, "old_age_survival")[words.sp])
    return words.where(survives_shade | survives_age | (words.c & ~mature), r_m)


def fragment(survivors: Words, cut_off: Words) -> Words:
    """The successor multiset: what is left of the old words, and the pieces that % cut off."""
    return Words(
        *(
            np.concatenate([getattr(survivors, name), getattr(cut_off, name)])
            for name in ("x_m", "r_m", "sp", "c", "plant_id", "born")
        )
    )


def _answer_queries(words: Words, site: Site, parameters: MultisetParameters) -> Words:
    """The environment's part: ?E(c) of every word is set."""
    dominated = environment.dominated(words.x_m, words.r_m, words.plant_id, site.size_m, periodic=parameters.periodic)
    return Words(words.x_m, words.r_m, words.sp, ~dominated, words.plant_id, words.born)


class MultisetLSystem:
    """The model; see the module's page."""

    Parameters = MultisetParameters

    def init(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology], seed: int) -> State:
        """The axiom: nothing but X (succession), or the cohort (self-thinning)."""
        n = _cohort_size(parameters, site) if species else 0
        _refuse_overflow(1, n)
        rng = child_rng(seed, "community", 0)
        sp = rng.integers(0, max(1, len(species)), size=n, dtype=np.uint16)
        words = _answer_queries(_new_words(sp, site, species, rng, 1, 0), site, parameters)
        return State(parameters, site, tuple(species), seed, 0, 1 + n, words)

    def step(self, state: State) -> State:
        """One derivation step: productions, fragmentation, environment."""
        rng = child_rng(state.seed, "community", state.step + 1)
        words = rewrite(state, rng.random(len(state.words)))
        next_id = state.next_id
        if state.parameters.program == "succession":
            cut_off = successor_of_x(state, rng)
            words, next_id = fragment(words, cut_off), next_id + len(cut_off)
        words = _answer_queries(words, state.site, state.parameters)
        return State(state.parameters, state.site, state.species, state.seed, state.step + 1, next_id, words)

    def population(self, state: State) -> Population:
        """Snapshot: c and r >= R give the status; z is 0."""
        words, species = state.words, state.species
        mature = words.r_m >= _of_species(species, "max_radius_m")[words.sp]
        status = np.where(mature, np.uint8(Status.MATURE), np.uint8(Status.GROWING))
        status[~words.c] = Status.DOMINATED
        position_m = np.zeros((len(words), 3))
        position_m[:, :2] = words.x_m
        exponent = _of_species(species, "height_exponent")[words.sp]
        return Population(
            time_yr=state.step * state.parameters.step_yr,
            species_names=tuple(one.name for one in species),
            plant_id=words.plant_id,
            species=words.sp,
            position_m=position_m,
            radius_m=words.r_m,
            height_m=_of_species(species, "height_scale")[words.sp] * words.r_m**exponent,
            age_yr=(state.step - words.born).astype(np.float64) * state.parameters.step_yr,
            status=status,
        )

    def estimate_bytes(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> int:
        """Bytes for the bound of the mean number of plants and six standard deviations of a Poisson number more."""
        plants = _expected_plants_at_most(parameters, site, species)
        plants = min(plants + 6 * math.sqrt(plants), 1e30)
        return _BYTES_AT_LEAST + math.ceil(plants * _BYTES_PER_PLANT)


def _cohort_size(parameters: MultisetParameters, site: Site) -> int:
    if parameters.program == "succession":
        return 0
    per_ha = parameters.initial_plants_per_ha
    return round(min((_DEFAULT_COHORT_PER_HA if per_ha is None else per_ha) * site.area_ha, 1e30))


def _expected_plants_at_most(parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> float:
    """Upper bound of the mean number of plants at any step.

    In succession: arrivals a step times the mean number of steps that a plant lives. A step of life is spent growing
    (R / growth of them at most), dominated or mature, and those two end a life with probabilities 1 - shaded and
    1 - oldage; nobody lives longer than the simulation.
    """
    if parameters.program == "self_thinning":
        return float(_cohort_size(parameters, site))
    total = 0.0
    for one, arrivals in zip(species, _seedlings_per_step(parameters, site, species), strict=True):
        growth = one.growth_m_per_yr * parameters.step_yr
        growing = one.max_radius_m / growth if growth > 0 else math.inf
        shaded = 1 / (1 - one.shade_tolerance) if one.shade_tolerance < 1 else math.inf
        old = 1 / (1 - one.old_age_survival) if one.old_age_survival < 1 else math.inf
        total += min(float(arrivals), 1e30) * min(growing + shaded + old + 2, parameters.steps)
    return total


MODEL = MultisetLSystem()
