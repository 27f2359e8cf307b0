"""The command `plant`: plants on their own, and the list of the species that come with forestgen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from forestgen.cli.arguments import Json, Overwrite, Quiet, Seed, progress_of
from forestgen.cli.console import Printer
from forestgen.core.figures import count, show_bytes, table_lines, three_digits

if TYPE_CHECKING:
    from forestgen.runs.single_plant import SinglePlant

_MOST_FILES = 6  # named one by one

SpeciesName = Annotated[
    str | None, typer.Argument(metavar="SPECIES", help="A species' name, see --list, or its YAML file.")
]
HeightM = Annotated[
    float | None, typer.Option("--height-m", metavar="METRES", help="By default that of a mature plant.")
]
Out = Annotated[
    list[Path] | None,
    typer.Option(
        "--out",
        "-o",
        metavar="FILE",
        help="A mesh: .glb, .ply, .obj (with its .mtl), .usd, .usda, .usdc, .usdz; or a picture: .png. May be "
        "repeated; by default outputs/SPECIES.glb and .png.",
    ),
]
PlantCount = Annotated[
    int, typer.Option("--count", metavar="N", help="So many plants, of seeds from --seed on: tree-0001.glb, ...")
]
Frames = Annotated[
    int | None,
    typer.Option(
        "--frames",
        metavar="N",
        help="So many poses in the wind, of a species of the generator strands: tree-0001.glb, ...",
    ),
]
Detail = Annotated[
    int | None,
    typer.Option(
        "--detail",
        metavar="0..2",
        min=0,
        max=2,
        help="How finely leaves and flowers are drawn: 2 for close views; by default as the species' file says.",
    ),
]
WoodTriangles = Annotated[
    int | None,
    typer.Option(
        "--wood-triangles",
        metavar="N",
        help="In mesh files, wood of about N triangles with one baked texture, for real-time programs.",
    ),
]
SizePx = Annotated[
    tuple[int, int], typer.Option("--size-px", metavar="W H", help="Size of the picture.", show_default="540 720")
]
Samples = Annotated[
    int, typer.Option("--samples", metavar="N", min=1, max=65536, help="Light paths a pixel of the picture.")
]
DistanceM = Annotated[
    float | None,
    typer.Option(
        "--distance-m",
        metavar="METRES",
        help="How far the camera stands from the plant; by default as far as a normal lens asks for.",
    ),
]
LookAtM = Annotated[
    float | None,
    typer.Option(
        "--look-at-m", metavar="METRES", help="Look at this height through a normal lens, not at the whole plant."
    ),
]


def plant(
    species: SpeciesName = None,
    list_species: Annotated[bool, typer.Option("--list", help="List the species that come with forestgen.")] = False,
    height_m: HeightM = None,
    seed: Seed = 0,
    out: Out = None,
    plants: PlantCount = 1,
    frames: Frames = None,
    frames_per_s: Annotated[float, typer.Option("--frames-per-s", metavar="N", help="Pace of the frames.")] = 12.0,
    detail: Detail = None,
    wood_triangles: WoodTriangles = None,
    size_px: SizePx = (540, 720),
    samples: Samples = 32,
    distance_m: DistanceM = None,
    look_at_m: LookAtM = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Grow one plant: mesh, picture, numbers."""
    if list_species:
        _library(as_json)
        return
    if species is None:
        raise typer.BadParameter("name a species, or give --list", param_hint="SPECIES")
    from forestgen.api.plants import grow_files

    made = grow_files(
        species,
        out or None,
        height_m=height_m,
        seed=seed,
        count=plants,
        frames=frames,
        frames_per_s=frames_per_s,
        detail=detail,
        wood_triangles=wood_triangles,
        size_px=size_px,
        samples=samples,
        distance_m=distance_m,
        look_at_m=look_at_m,
        overwrite=overwrite,
        progress=progress_of(quiet),
    )
    _print(made, Printer(quiet), frames=frames is not None, as_json=as_json)


def _print(made: Sequence[SinglePlant], say: Printer, *, frames: bool, as_json: bool) -> None:
    if as_json:
        say.json([_plain(one) for one in made])
        return
    if len(made) == 1:
        _print_one(made[0], say)
    else:
        _print_many(made, say, frames=frames)
    _print_files({path: size for one in made for path, size in one.files.items()}, say)


def _plain(one: SinglePlant) -> dict[str, Any]:
    from dataclasses import asdict

    return {**asdict(one), "files": {str(path): size for path, size in one.files.items()}}


def _print_one(one: SinglePlant, say: Printer) -> None:
    say(f"{one.species}: {one.height_m:.2f} m tall, crown {one.crown_width_m:.2f} m wide")
    parts = ", ".join(f"{number:,} {part}" for part, number in one.triangles.items())
    say(f"  {sum(one.triangles.values()):,} triangles: {parts}")
    index = f"; leaf area index {one.leaf_area_index:.2f}" if one.leaf_area_m2 else ""
    say(f"  leaf area {one.leaf_area_m2:.3g} m² (one side){index}")
    say(f"  dry mass {_mass(one.wood_kg)} of wood, {_mass(one.leaf_kg)} of leaves")


def _print_many(made: Sequence[SinglePlant], say: Printer, *, frames: bool) -> None:
    rows = [("frame" if frames else "seed", "height", "crown", "triangles", "leaf area", "index", "wood", "leaves")]
    for number, one in enumerate(made, start=1):
        rows.append(
            (
                str(number if frames else one.seed),
                f"{one.height_m:.2f} m",
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


def _print_files(files: dict[Path, int], say: Printer) -> None:
    shown = [f"{path} ({show_bytes(size)})" for path, size in files.items()]
    if len(shown) > _MOST_FILES:
        total = show_bytes(sum(files.values()))
        shown = [shown[0], "...", f"{shown[-1]}; {len(shown)} files, {total}"]
    say("files: " + ", ".join(shown))


def _mass(kilograms: float) -> str:
    """Three digits, in the unit that reads best."""
    for unit, size in (("t", 1e3), ("kg", 1.0), ("g", 1e-3)):
        if kilograms >= size:
            return f"{three_digits(kilograms / size)} {unit}"
    return f"{three_digits(kilograms * 1e6)} mg" if kilograms else "none"


def _library(as_json: bool) -> None:
    """List the shipped species: no plant is grown."""
    from dataclasses import asdict

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
