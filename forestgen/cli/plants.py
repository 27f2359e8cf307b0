"""`forestgen plant`: plants on their own, and the list of the species that come with forestgen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from forestgen.cli.console import Bars, count, output
from forestgen.recipe.assets import list_assets

if TYPE_CHECKING:
    from forestgen.stages.single_plant import SinglePlant

_MOST_FILES = 6  # named one by one


def plant(
    species: str,
    outputs: Sequence[Path],
    bars: Bars,
    *,
    overwrite: bool,
    growth: Mapping[str, Any],
    view: Mapping[str, Any],
) -> None:
    """Grow and write; `growth` and `view` hold fields of `Order` and `Shot`."""
    from forestgen.stages.single_plant import Order, default_outputs, grow_plants
    from forestgen.stages.studio import Shot

    paths = tuple(outputs) or default_outputs(species)
    order = Order(species, paths, shot=Shot(**view), overwrite=overwrite, **growth)
    with bars.running():
        made = grow_plants(order, bars)
    out = output()
    if len(made) == 1:
        _say_one(out, made[0])
    else:
        _say_many(out, made, frames=order.frames is not None)
    _say_files(out, {path: size for one in made for path, size in one.files.items()})


def _say(out: Console, text: str) -> None:
    out.print(Text(text))  # names may hold brackets, which are no markup


def _say_one(out: Console, one: SinglePlant) -> None:
    _say(out, f"{one.species}: {one.height_m:.2f} m tall, crown {one.crown_width_m:.2f} m wide")
    parts = ", ".join(f"{number:,} {part}" for part, number in one.triangles.items())
    _say(out, f"  {sum(one.triangles.values()):,} triangles: {parts}")
    index = f"; leaf area index {one.leaf_area_index:.2f}" if one.leaf_area_m2 else ""
    _say(out, f"  leaf area {one.leaf_area_m2:.3g} m² (one side){index}")
    _say(out, f"  dry mass {_mass(one.wood_kg)} of wood, {_mass(one.leaf_kg)} of leaves")


def _say_many(out: Console, made: list[SinglePlant], *, frames: bool) -> None:
    table = Table("frame" if frames else "seed", box=None, pad_edge=False, header_style="")
    for title in ("height", "crown", "triangles", "leaf area", "index", "wood", "leaves"):
        table.add_column(title, justify="right")
    for number, one in enumerate(made, start=1):
        table.add_row(
            str(number if frames else one.seed),
            f"{one.height_m:.2f} m",
            f"{one.crown_width_m:.2f} m",
            f"{sum(one.triangles.values()):,}",
            f"{one.leaf_area_m2:.3g} m²",
            f"{one.leaf_area_index:.2f}",
            _mass(one.wood_kg),
            _mass(one.leaf_kg),
        )
    _say(out, f"{count(len(made), 'frame' if frames else 'plant')} of {made[0].species}")
    out.print(table)


def _say_files(out: Console, files: dict[Path, int]) -> None:
    shown = [f"{path} ({_size(size)})" for path, size in files.items()]
    if len(shown) > _MOST_FILES:
        total = _size(sum(files.values()))
        shown = [shown[0], "...", f"{shown[-1]}; {len(shown)} files, {total}"]
    _say(out, "files: " + ", ".join(shown))


def _mass(kilograms: float) -> str:
    """Three digits, in the unit that reads best."""
    for unit, size in (("t", 1e3), ("kg", 1.0), ("g", 1e-3)):
        if kilograms >= size:
            return f"{_three_digits(kilograms / size)} {unit}"
    return f"{_three_digits(kilograms * 1e6)} mg" if kilograms else "none"


def _size(size: int) -> str:
    for unit, step in (("GB", 10**9), ("MB", 10**6), ("kB", 10**3)):
        if size >= step:
            return f"{_three_digits(size / step)} {unit}"
    return f"{size} bytes"


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def library() -> None:
    """List the shipped species: no plant is grown."""
    out = output()
    table = Table("name", box=None, pad_edge=False, header_style="")
    table.add_column("height", justify="right")
    table.add_column("width", justify="right")
    table.add_column("generator")
    table.add_column("description")
    for row in _rows(list_assets("species")):
        table.add_row(*(Text(cell) for cell in row))
    out.print(table)
    _say(out, "height and width are a mature plant's; forestgen models NAME shows a species' file")


def _rows(names: Iterable[str]) -> Iterable[tuple[str, ...]]:
    from forestgen.stages.single_plant import drawn_of, mature_size_m

    for name in names:
        species = drawn_of(name, 0).species[name]
        height_m, width_m = mature_size_m(species)
        yield name, f"{height_m:.3g} m", f"{width_m:.3g} m", species.plant.generator, species.description
