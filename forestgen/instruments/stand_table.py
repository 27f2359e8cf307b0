"""The table of a stand that a forester reads, measured on the geometry that is rendered.

| column | what it is, of the living plants of the row |
|---|---|
| `stems_per_ha` | plants whose stem's diameter at 1.3 m (DBH) is at least `min_dbh_cm`: the row's stems |
| `basal_area_m2_per_ha` | of the stems' sections at 1.3 m |
| `quadratic_mean_diameter_cm` | of the stems: the diameter of the mean basal area |
| `mean_height_m` | mean of the stems |
| `dominant_height_m` | mean of the 100 thickest stems a hectare, or all if fewer; of plants in a row without stems |
| `slenderness` | median of height over DBH of the stems |
| `stem_volume_m3_per_ha` | of the stems' trunks over bark, from the ground to the tip |
| `biomass_t_per_ha` | of all plants, dry, above the ground: wood volume by density, leaf area by its mass per area |
| `leaf_area_index` | one side of all leaves of all plants over the site's area |
| `canopy_cover` | share of vertical rays that meet a plant of the row at least 1.3 m above the ground |

Storeys: upper from 2/3 of the mean height of the stand's 100 thickest plants a hectare on, lower below 1/3, middle
between them (IUFRO; Leibundgut 1956). A stand without a stem at 1.3 m has none. A plant of several stems counts as one
stem of their basal area. Crowns that reach over the edge of a site that repeats cover its other side. Dead trees are
counted alone: those that stand, those that lie with the volume of their stems on the ground, and stumps. Foresters'
definitions: Pretzsch 2009, Forest Dynamics, Growth and Yield, sections 8.1 to 8.4.

The profile is leaf area density, m2/m3, by height above the plants' stem bases; what hangs lower counts in the lowest
layer.

Example: ``forestgen measure stand_table RECIPE --out stand.csv``; or, for short, ``forestgen stand RECIPE``.

References
----------
H. Leibundgut, Empfehlungen für die Baumklassenbildung und Methodik bei Versuchen über die Wirkung von
Waldpflegemassnahmen, Mitteilungen der Schweizerischen Anstalt für das forstliche Versuchswesen, 1956.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, astuple, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.population import Status
from forestgen.core.dead_wood import DeadForm, are_lying
from forestgen.core.figures import table_lines, three_digits
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.core.progress import Progress, Timings
from forestgen.core.randomness import child_rng
from forestgen.dataset.formats.format import finite
from forestgen.dataset.manifest import package_versions
from forestgen.instruments.instrument import Instrument, Reading
from forestgen.recipe.fields import Number, Section
from forestgen.recipe.load import LoadedRecipe
from forestgen.render.cover import plants_below
from forestgen.render.identity import SceneTracer
from forestgen.scene.build import BuiltScene
from forestgen.scene.plant_measures import PlantMeasures, PlantMeter
from forestgen.scene.spec import Instances

MIN_DBH_CM = 7.0
STOREYS = ("upper", "middle", "lower")
ALL = "all"
_DOMINANT_PER_HA = 100
_LEAST_DBH_M = 0.01  # of plants in the picture: tall herbs have stems too
_RAYS = 16_384  # on the site; where nothing repeats it, those beyond its edges come on top
_LAYERS_M, _FEWEST_LAYERS = (1.0, 0.5, 0.2, 0.1, 0.05), 15
_DEAD = ("standing_dead_per_ha", "lying_dead_per_ha", "lying_dead_m3_per_ha", "stumps_per_ha")
_HEADS = ("stems/ha", "BA m2/ha", "Dq cm", "H m", "Hdom m", "H/D", "V m3/ha", "AGB t/ha", "LAI", "cover %")
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class StandKeys(Section):
    """Keys of a stand table."""

    min_dbh_cm: Number = Field(MIN_DBH_CM, ge=0, le=100, description="Least diameter at 1.3 m of a stem, cm.")


@dataclass(frozen=True)
class StandRow:
    """A species and storey, or all of them; see the module's table. NaN: no plant that could be measured."""

    species: str
    storey: str
    stems_per_ha: float
    basal_area_m2_per_ha: float
    quadratic_mean_diameter_cm: float
    mean_height_m: float
    dominant_height_m: float
    slenderness: float
    stem_volume_m3_per_ha: float
    biomass_t_per_ha: float
    leaf_area_index: float
    canopy_cover: float

    def figures(self) -> dict[str, float | None]:
        """What was measured, by the names of the fields; NaN is None."""
        return {key: finite(value) for key, value in asdict(self).items() if key not in ("species", "storey")}


@dataclass(frozen=True, repr=False)
class StandTable(Reading):
    """A stand, measured. `print` shows the table."""

    rows: tuple[StandRow, ...]  # of each species its storeys, then all of it; then the same of all species
    site_ha: float
    min_dbh_cm: float
    standing_dead_per_ha: float
    lying_dead_per_ha: float
    lying_dead_m3_per_ha: float  # of stems, over bark
    stumps_per_ha: float
    layer_edges_m: Floats  # (K + 1,) above the stem bases
    leaf_area_density: Mapping[str, Floats]  # species -> (K,) m2/m3
    dbh_m: Floats  # (M,) of the living plants of 1 cm and more, whose heights are drawn
    height_m: Floats  # (M,) of these
    species: NDArray[np.str_]  # (M,) of these
    colours: Mapping[str, str]  # of species on plots, where their files give one
    notes: tuple[str, ...] = ()  # of the community and the scene: what was asked for and reached, what was left out

    @property
    def total(self) -> StandRow:
        """All species and storeys."""
        return self.rows[-1]

    def __repr__(self) -> str:
        return f"<StandTable: {self.total.stems_per_ha:,.0f} stems/ha, LAI {self.total.leaf_area_index:.2f}>"

    def lines(self) -> Iterator[str]:
        yield from table_lines([("species", "storey", *_HEADS), *map(_cells, self._shown())])
        stem = f"DBH from {self.min_dbh_cm:g} cm on"
        yield f"living plants of a site of {three_digits(self.site_ha)} ha, as they are rendered; {stem}: stems"
        yield "stems/ha, BA (basal area), Dq (quadratic mean diameter), H (mean height), H/D (median), V (trunk): stems"
        yield f"Hdom: mean height of the {_DOMINANT_PER_HA} thickest stems a hectare, or plants in a row without stems"
        yield f"storeys: from 2/3, 1/3 of the mean height of the {_DOMINANT_PER_HA} thickest plants a hectare on"
        yield "AGB (dry biomass above the ground), LAI (one side of the leaves): all plants, also those without a DBH"
        yield f"cover: vertical rays that meet a plant above {BREAST_HEIGHT_M} m; one ray may meet several rows"
        yield from self._dead_lines()
        yield from (f"note: {one}" for one in self.notes)

    def _dead_lines(self) -> Iterator[str]:
        found = []
        if self.standing_dead_per_ha:
            found.append(f"{self.standing_dead_per_ha:,.0f} standing dead plants/ha")
        if self.lying_dead_per_ha:
            found.append(f"{self.lying_dead_per_ha:,.0f} lying/ha, stems of {self.lying_dead_m3_per_ha:.1f} m3/ha")
        if self.stumps_per_ha:
            found.append(f"{self.stumps_per_ha:,.0f} stumps/ha")
        if found:
            yield f"besides: {'; '.join(found)}"

    def _shown(self) -> Iterator[StandRow]:
        """Without sums of one."""
        storeys = Counter(one.species for one in self.rows)
        for row in self.rows:
            is_sum_of_one = row.storey == ALL and storeys[row.species] == 2
            if not (is_sum_of_one or (row.species == ALL and len(storeys) == 2)):
                yield row

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "site_ha": self.site_ha,
            "min_dbh_cm": self.min_dbh_cm,
            **{name: getattr(self, name) for name in _DEAD},
            "notes": list(self.notes),
            "rows": [{"species": one.species, "storey": one.storey, **one.figures()} for one in self.rows],
            "profile": {
                "layer_edges_m": self.layer_edges_m.tolist(),
                "leaf_area_density_m2_per_m3": {key: one.tolist() for key, one in self.leaf_area_density.items()},
            },
        }

    def content(self, ending: str, loaded: LoadedRecipe) -> bytes:
        if ending == ".csv":
            stream = io.StringIO(newline="")
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow([one.name for one in fields(StandRow)])
            for row in self.rows:
                writer.writerow([row.species, row.storey, *row.figures().values()])
            return stream.getvalue().encode()
        about = {"schema": "forestgen-stand/1", "recipe_hash": loaded.hash, "versions": package_versions()}
        text = json.dumps(about | self.as_dict(), indent=1, allow_nan=False, ensure_ascii=False)
        return (text + "\n").encode()


class StandMeter(Instrument[StandKeys, StandTable]):
    """Measures of all plants, and vertical rays; no light is traced."""

    name = "stand_table"
    Parameters = StandKeys
    endings = (".csv", ".json")

    def measure(self, scene: BuiltScene, keys: StandKeys, progress: Progress, timings: Timings) -> StandTable:
        spec = scene.at(scene.spec.cameras[0].time_s)
        with timings("measures"):
            meter = PlantMeter(spec.exemplars)
        return stand_table(scene, SceneTracer(spec, timings), meter, timings, min_dbh_cm=keys.min_dbh_cm)


INSTRUMENT = StandMeter()


def stand_table(
    scene: BuiltScene,
    tracer: SceneTracer,
    meter: PlantMeter,
    timings: Timings,
    *,
    min_dbh_cm: float = MIN_DBH_CM,
) -> StandTable:
    """Measure a stand, without what stands around its site. `tracer` and `meter` are of the scene at any time."""
    with timings("stand"):
        own = tracer.spec.instances.at(slice(0, len(scene.population)))
        measures = meter.measure(own)
        plants = _Plants.of(scene, own, meter, measures, min_dbh_cm / 100.0)
        met = _met_by_rays(scene, tracer, plants, float(measures.crown_width_m.max(initial=0.0)))
        edges_m, density = _profile(plants, meter, own)
    stems = (np.nan_to_num(plants.dbh_m) >= _LEAST_DBH_M) & plants.alive
    return StandTable(
        rows=tuple(_rows(plants, met)),
        site_ha=plants.site_ha,
        min_dbh_cm=min_dbh_cm,
        **_dead_amounts(scene, own, plants),
        layer_edges_m=edges_m,
        leaf_area_density=density,
        dbh_m=plants.dbh_m[stems],
        height_m=plants.height_m[stems],
        species=np.array(plants.names)[plants.species[stems]],
        colours={name: one.map_colour for name, one in scene.drawn.species.items() if one.map_colour},
        notes=scene.notes,
    )


def _dead_amounts(scene: BuiltScene, own: Instances, plants: _Plants) -> dict[str, float]:
    """Of dead trees, by the names of `_DEAD`; lying stems by the geometry that is rendered."""
    form = scene.population.columns.get("dead_form", np.where(plants.dead, DeadForm.STANDING, 0))
    lying_m3 = np.array([one.lying_m3 for one in scene.spec.exemplars])[own.exemplar]
    volume = float(np.sum(lying_m3 * np.abs(np.linalg.det(own.transform[:, :, :3]))))
    dead = form[plants.dead]
    numbers = (np.sum(dead == DeadForm.STANDING), np.sum(are_lying(dead)), volume, np.sum(dead == DeadForm.STUMP))
    return {name: float(one) / plants.site_ha for name, one in zip(_DEAD, numbers, strict=True)}


@dataclass(frozen=True)
class _Plants:
    """All instances of a site, one row each; buildings are neither alive nor dead."""

    names: tuple[str, ...]  # of species
    site_ha: float
    min_dbh_m: float
    alive: Mask
    dead: Mask
    species: NDArray[np.intp]
    storey: NDArray[np.intp]  # of `STOREYS`; 3: the stand has none
    dbh_m: Floats
    height_m: Floats
    leaf_area_m2: Floats
    stem_m3: Floats
    biomass_kg: Floats

    @classmethod
    def of(
        cls, scene: BuiltScene, own: Instances, meter: PlantMeter, measures: PlantMeasures, min_dbh_m: float
    ) -> _Plants:
        population, known = scene.population, scene.drawn.species
        real = np.isin(population.plant_id, scene.plan.community.obstacles.left_out_of(population).plant_id)
        tissue = [known[name].tissue if name in known else None for name in population.species_names]
        kg_per_m3 = np.array([one.wood_density_kg_per_m3 if one else 0.0 for one in tissue])
        kg_per_m2 = np.array([one.leaf_mass_per_area_kg_per_m2 if one else 0.0 for one in tissue])
        species = population.species.astype(np.intp)
        stem_m3, wood_m3 = meter.volumes_m3(own)
        dead = population.status == Status.DEAD
        site_ha = scene.plan.community.site.area_ha
        alive = real & ~dead
        top_m = _dominant_height_m(measures.dbh_m[alive], population.height_m[alive], site_ha)
        storey = np.searchsorted([-top_m * 2 / 3, -top_m / 3], -population.height_m, side="left")
        return cls(
            names=population.species_names,
            site_ha=site_ha,
            min_dbh_m=min_dbh_m,
            alive=alive,
            dead=real & dead,
            species=species,
            storey=np.full(len(population), len(STOREYS)) if math.isnan(top_m) else storey,
            dbh_m=measures.dbh_m,
            height_m=population.height_m,
            leaf_area_m2=measures.leaf_area_m2,
            stem_m3=stem_m3,
            biomass_kg=wood_m3 * kg_per_m3[species] + measures.leaf_area_m2 * kg_per_m2[species],
        )


def _dominant_height_m(dbh_m: Floats, height_m: Floats, site_ha: float) -> float:
    """Mean height of the 100 thickest a hectare, at least one; NaN of none."""
    count = max(1, round(_DOMINANT_PER_HA * site_ha))
    thickest = np.argsort(-np.nan_to_num(dbh_m), kind="stable")[:count]
    thickest = thickest[np.isfinite(dbh_m[thickest])]
    return float(height_m[thickest].mean()) if len(thickest) else math.nan


def _met_by_rays(scene: BuiltScene, tracer: SceneTracer, plants: _Plants, reach_m: float) -> Mask:
    """(R, S, 4) whether each ray meets a living plant of each species and storey, the fourth: of none."""
    community, height = scene.plan.community, scene.plan.views.height
    size_m = np.array(community.site.size_m)
    number = np.maximum(np.round(size_m * math.sqrt(_RAYS / np.prod(size_m))), 1).astype(int)
    cell = np.stack(np.meshgrid(*map(np.arange, number), indexing="ij"), axis=-1).reshape(-1, 2)
    site_m = (cell + child_rng(scene.drawn.image_seed, "stand", "rays").random(cell.shape)) / number * size_m
    met = np.zeros((len(cell), len(plants.names), len(STOREYS) + 1), dtype=np.bool_)
    periodic, copied = community.parameters.periodic, scene.repeated
    shifts = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)] if periodic and copied is None else [(0, 0)]
    plant = np.arange(len(plants.alive)) if copied is None or not periodic else copied
    point = np.concatenate([site_m + np.array(shift) * size_m for shift in shifts])
    near = np.flatnonzero(np.all((point >= -reach_m) & (point <= size_m + reach_m), axis=1))
    low_m = height(*point[near].T) + BREAST_HEIGHT_M
    top_m = float((scene.population.position_m[:, 2] + scene.population.height_m).max(initial=0.0)) + reach_m
    start_m = np.column_stack([point[near], np.full(len(near), top_m)])
    above = low_m < top_m
    ray = near[above] % len(cell)
    for rays, rows in plants_below(tracer, start_m[above], top_m - low_m[above]):
        mine = rows < len(plant)  # the others are around the site
        rays, rows = rays[mine], plant[rows[mine]]
        lives = plants.alive[rows]
        row = rows[lives]
        met[ray[rays[lives]], plants.species[row], plants.storey[row]] = True
    return met


def _profile(plants: _Plants, meter: PlantMeter, own: Instances) -> tuple[Floats, dict[str, Floats]]:
    """Edges of layers, and the leaf area density in them of each species that has leaves."""
    leafy = plants.alive & (plants.leaf_area_m2 > 0.0)
    top_m = float(plants.height_m[leafy].max(initial=0.0))
    layer_m = next((one for one in _LAYERS_M if top_m >= _FEWEST_LAYERS * one), _LAYERS_M[-1])
    edges_m: Floats = np.arange(max(1, math.ceil(top_m / layer_m - 1e-6)) + 1, dtype=np.float64) * np.float64(layer_m)
    group = np.where(leafy, plants.species, -1)
    area_m2 = meter.leaf_area_by_height_m2(own, plants.leaf_area_m2, group, edges_m)
    density = area_m2 / (plants.site_ha * 1e4 * layer_m)
    return edges_m, {name: one for name, one in zip(plants.names, density, strict=False) if one.any()}


def _rows(plants: _Plants, met: Mask) -> Iterator[StandRow]:
    """Of each species that lives its storeys, then all of it; then the same of all species."""
    storeys = (*STOREYS, ALL)
    groups = [([k], name) for k, name in enumerate(plants.names) if np.any(plants.alive & (plants.species == k))]
    groups.append((list(range(len(plants.names))), ALL))
    for species, name in groups:
        mine = plants.alive & np.isin(plants.species, species)
        there = np.unique(plants.storey[mine]).tolist()
        for storey in there:
            yield _row(plants, name, storeys[storey], mine & (plants.storey == storey), met[:, species, storey])
        if there != [len(STOREYS)]:
            yield _row(plants, name, ALL, mine, met[:, species].reshape(len(met), -1))


def _row(plants: _Plants, species: str, storey: str, mine: Mask, met: Mask) -> StandRow:
    """`mine`: (N,) plants. `met`: (R, M) rays that meet some of them."""
    stem = mine & (np.nan_to_num(plants.dbh_m) >= plants.min_dbh_m) & np.isfinite(plants.dbh_m)
    dbh_m, height_m, ha = plants.dbh_m[stem], plants.height_m[stem], plants.site_ha
    area_m2 = math.pi / 4.0 * float(np.sum(dbh_m**2))
    has = len(dbh_m) > 0
    tall = stem if has else mine
    return StandRow(
        species=species,
        storey=storey,
        stems_per_ha=len(dbh_m) / ha,
        basal_area_m2_per_ha=area_m2 / ha,
        quadratic_mean_diameter_cm=100.0 * math.sqrt(float(np.mean(dbh_m**2))) if has else math.nan,
        mean_height_m=float(height_m.mean()) if has else math.nan,
        dominant_height_m=_dominant_height_m(plants.dbh_m[tall], plants.height_m[tall], ha),
        slenderness=float(np.median(height_m / dbh_m)) if has else math.nan,
        stem_volume_m3_per_ha=float(plants.stem_m3[stem].sum()) / ha,
        biomass_t_per_ha=float(plants.biomass_kg[mine].sum()) / 1000.0 / ha,
        leaf_area_index=float(plants.leaf_area_m2[mine].sum()) / (ha * 1e4),
        canopy_cover=float(met.any(axis=1).mean()),
    )


def _cells(row: StandRow) -> tuple[str, ...]:
    species, storey, *values = astuple(row)
    values[-1] *= 100.0
    digits = (0, 1, 1, 1, 1, 0, 0, 0, 2, 0)
    shown = (f"{value:,.{d}f}" if math.isfinite(value) else "" for value, d in zip(values, digits, strict=True))
    return species, storey, *shown
