"""The command `plant`: plants on their own, and the list of the species that come with forestgen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from forestgen.cli.console import Printer
from forestgen.core.figures import count, show_bytes, table_lines, three_digits

if TYPE_CHECKING:
    from forestgen.api.plants import SinglePlant

_THIN_M = 0.01  # stems of herbs are not shown
_MOST_FILES = 6  # named one by one
_OPTIONS = (  # of `grow_files`
    "height_m", "grown", "seed", "frames", "frames_per_s", "detail", "wood_triangles", "size_px", "samples",
    "distance_m", "look_at_m", "overwrite",
)  # fmt: skip


def plant(
    species: str | None = None,
    list_: bool = False,
    height_m: float | None = None,
    grown: str = "stand",
    seed: int = 0,
    out: list[Path] | None = None,
    count_: int = 1,
    frames: int | None = None,
    frames_per_s: float = 12.0,
    detail: int | None = None,
    wood_triangles: int | None = None,
    size_px: tuple[int, int] = (540, 720),
    samples: int = 32,
    distance_m: float | None = None,
    look_at_m: float | None = None,
    overwrite: bool = False,
    json_: bool = False,
    quiet: bool = False,
) -> None:
    """Grow one plant: mesh, picture, numbers.

    SPECIES  A species' name, see --list, or its YAML file.
    --list  List the species that come with forestgen.
    --height-m METRES  By default that of a mature plant.
    --grown HOW  How a tree grew: stand, in a closed one; open, without neighbours; suppressed, overgrown by others.
        [default: stand]
    --out -o FILE  A mesh: .glb, .ply, .obj (with its .mtl), .usd, .usda, .usdc, .usdz; or a picture: .png. May be
        repeated; by default outputs/SPECIES.glb and .png.
    --count N  So many plants, of seeds from --seed on: tree-0001.glb, ...
    --frames N  So many poses in the wind, of a species of the generator strands: tree-0001.glb, ...
    --frames-per-s N  Pace of the frames.
    --detail 0..2  How finely leaves and flowers are drawn: 2 for close views; by default as the species' file says.
        [0 to 2]
    --wood-triangles N  In mesh files, wood of about N triangles with one baked texture, for real-time programs.
    --size-px W H  Size of the picture. [default: 540 720]
    --samples N  Light paths a pixel of the picture. [1 to 65536]
    --distance-m METRES  How far the camera stands from the plant; by default as far as a normal lens asks for.
    --look-at-m METRES  Look at this height through a normal lens, not at the whole plant.
    """
    if list_:
        _library(json_)
        return
    if species is None:
        raise typer.BadParameter("name a species, or give --list", param_hint="SPECIES")
    from forestgen.api.plants import grow_files

    given = {name: value for name, value in locals().items() if name in _OPTIONS}
    made = grow_files(species, out or None, count=count_, progress=not quiet, **given)
    _print(made, Printer(quiet), json_, frames is not None)


def _print(made: Sequence[SinglePlant], say: Printer, as_json: bool, frames: bool) -> None:
    if as_json:
        say.json([{**asdict(one), "files": {str(path): size for path, size in one.files.items()}} for one in made])
        return
    if len(made) == 1:
        _print_one(made[0], say)
    else:
        _print_many(made, say, frames=frames)
    files = {path: size for one in made for path, size in one.files.items()}
    shown = [f"{path} ({show_bytes(size)})" for path, size in files.items()]
    if len(shown) > _MOST_FILES:
        shown = [shown[0], "...", f"{shown[-1]}; {len(shown)} files, {show_bytes(sum(files.values()))}"]
    say("files: " + ", ".join(shown))


def _print_one(one: SinglePlant, say: Printer) -> None:
    stem = f", stem {_stem(one)} at 1.3 m" if _stem(one) else ""
    base = "" if one.crown_base_m is None else f" and {one.crown_base_m:.2f} m above the ground"
    say(f"{one.species}: {one.height_m:.2f} m tall, crown {one.crown_width_m:.2f} m wide{base}{stem}")
    parts = ", ".join(f"{number:,} {part}" for part, number in one.triangles.items())
    say(f"  {sum(one.triangles.values()):,} triangles: {parts}")
    index = f"; leaf area index {one.leaf_area_index:.2f}" if one.leaf_area_m2 else ""
    say(f"  leaf area {three_digits(one.leaf_area_m2)} m² (one side){index}")
    say(f"  dry mass {_mass(one.wood_kg)} of wood, {_mass(one.leaf_kg)} of leaves")


def _print_many(made: Sequence[SinglePlant], say: Printer, *, frames: bool) -> None:
    first = "frame" if frames else "seed"
    rows = [(first, "height", "dbh", "crown", "triangles", "leaf area", "index", "wood", "leaves")]
    for number, one in enumerate(made, start=1):
        rows.append(
            (
                str(number if frames else one.seed),
                f"{one.height_m:.2f} m",
                _stem(one) or "none",
                f"{one.crown_width_m:.2f} m",
                f"{sum(one.triangles.values()):,}",
                f"{one.leaf_area_m2:.3g} m²",
                f"{one.leaf_area_index:.2f}",
                _mass(one.wood_kg),
                _mass(one.leaf_kg),
            )
        )
    say(f"{count(len(made), 'frame' if frames else 'plant')} of {made[0].species}")
    say("\n".join(table_lines(rows)))


def _stem(one: SinglePlant) -> str:
    """Diameter at breast height; empty without a stem there."""
    return "" if one.dbh_m is None or one.dbh_m < _THIN_M else f"{100 * one.dbh_m:.1f} cm"


def _mass(kilograms: float) -> str:
    """Three digits, in the unit that reads best."""
    for unit, size in (("t", 1e3), ("kg", 1.0), ("g", 1e-3)):
        if kilograms >= size:
            return f"{three_digits(kilograms / size)} {unit}"
    return f"{three_digits(kilograms * 1e6)} mg" if kilograms else "none"


def _library(as_json: bool) -> None:
    """List the shipped species: no plant is grown."""
    from forestgen import species

    found, say = species(), Printer()
    if as_json:
        say.json([asdict(one) for one in found])
        return
    names = max(len(one.name) for one in found)
    generators = max(len(one.generator) for one in found)
    say(f"{'name':<{names}}   height    width  {'generator':<{generators}}  description")
    for one in found:
        sizes = f"{one.height_m:>6.3g} m {one.crown_width_m:>6.3g} m"
        say(f"{one.name:<{names}} {sizes}  {one.generator:<{generators}}  {one.description}")
    say("height and width are a mature plant's; forestgen models NAME shows a species' file")
