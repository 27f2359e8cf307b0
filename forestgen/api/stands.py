"""Stands: the plant community that `Recipe.simulate` answers with."""

from __future__ import annotations

import io
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.history_files import map_colours
from forestgen.community.population import Population, Status
from forestgen.community.summary import SimulationSummary
from forestgen.core.arguments import shown
from forestgen.core.errors import RecipeError
from forestgen.recipe.suggestions import did_you_mean


class Stand:
    """The plants of a community at its last step.

    `stand["height_m"]` is a column as a NumPy array, `stand.table` all of them as a `pyarrow.Table`, `stand.plot()` a
    map. `summary` has stems and counts by species; `folder` is where files were written, None where none were.
    """

    def __init__(self, summary: SimulationSummary, folder: Path | None) -> None:
        self.summary, self.folder = summary, folder

    @property
    def population(self) -> Population:
        """The plants as the community models know them."""
        return self.summary.last

    @cached_property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Column -> (N,) array: plant_id, species, x_m, y_m, height_m, radius_m, age_yr, status, and the model's."""
        plants = self.population
        names = np.array([*plants.species_names, ""])
        return {
            "plant_id": plants.plant_id,
            "species": names[plants.species],
            "x_m": plants.position_m[:, 0],
            "y_m": plants.position_m[:, 1],
            "height_m": plants.height_m,
            "radius_m": plants.radius_m,
            "age_yr": plants.age_yr,
            "status": np.array([status.name.lower() for status in Status])[plants.status],
            **{name: np.asarray(values) for name, values in plants.columns.items()},
        }

    @property
    def table(self) -> Any:
        """The columns as a `pyarrow.Table`; those of several values a plant are lists."""
        import pyarrow as pa

        return pa.table(
            {name: pa.array(values if values.ndim == 1 else values.tolist()) for name, values in self.columns.items()}
        )

    @property
    def species(self) -> tuple[str, ...]:
        """Names of the recipe's species."""
        return self.population.species_names

    @property
    def notes(self) -> tuple[str, ...]:
        """For people."""
        return self.summary.notes

    @property
    def biome(self) -> str | None:
        """What people call land of the climate that chose the recipe's species; None if no climate did."""
        return self.summary.biome

    def __getitem__(self, column: str) -> NDArray[Any]:
        try:
            return self.columns[column]
        except (KeyError, TypeError):
            expected, hint = "one of " + ", ".join(self.columns), did_you_mean(str(column), self.columns)
            raise RecipeError("the stand has no such column", expected=expected, got=shown(column), hint=hint) from None

    def __len__(self) -> int:
        return len(self.population)

    def plot(self, ax: Any = None) -> Any:
        """A matplotlib figure: the map of the plants, each at its size.

        Parameters
        ----------
        ax : matplotlib Axes to draw into, whose figure is returned; None: a new figure.
        """
        from matplotlib.axes import Axes

        from forestgen.community.plots import map_figure

        if not (ax is None or isinstance(ax, Axes)):
            raise RecipeError("these are no axes", parameter="ax", expected="matplotlib Axes, one pair", got=shown(ax))
        plan = self.summary.plan
        return map_figure(
            plan.obstacles.left_out_of(self.population),
            plan.site,
            map_colours(plan),
            periodic=plan.parameters.periodic,
            obstacles=plan.obstacles,
            axes=ax,
        )

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.plot().savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()

    def __repr__(self) -> str:
        counts = ", ".join(f"{number:,} {name}" for name, number in self.summary.counts.items())
        return f"<Stand at year {self.population.time_yr:g}: {counts or 'no plants'}>"
