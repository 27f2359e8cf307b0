"""Grows, measures and photographs the species: `uv run python docs/species_sheet.py` (some five minutes on two cores).

docs/species.json               numbers of a mature plant of each species
docs/pictures/species/NAME.jpg  the plant close up and whole, from 30 m and from a person's height
docs/pictures/library.jpg       all of these pictures in one sheet
docs/species.md                 the page about them, see docs/generate.py

With names behind it, `uv run python docs/species_sheet.py oak daisy`, it does these alone and keeps the others.
"""

from __future__ import annotations

import io
import json
import sys
import time
from pathlib import Path

import generate
import numpy as np
from PIL import Image

from forestgen.core.progress import Silent
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.assets import list_assets
from forestgen.stages.plan import Plan
from forestgen.stages.scene import materials_of
from forestgen.stages.single_plant import described, grow, plan_of
from forestgen.stages.studio import Shot, camera_of, photograph, size_of_m

PICTURES = Path(__file__).parent / "pictures"
SEED = 3
VIEW_PX = (180, 240)
MOST_BYTES = 40_000
COLUMNS = 4
FAR_M = 30.0
# Height looked at as a share of the plant's, and the window's height in metres, where `close_up` shows too little.
CLOSE: dict[str, tuple[float, float]] = {
    "daisy": (0.93, 0.09),
    "fireweed": (0.78, 0.4),
    "lily": (0.9, 0.3),
    "log": (0.6, 0.5),
    "palm": (0.93, 2.4),
    "shrub": (0.6, 0.4),
    "snag": (0.5, 1.2),
    "stump": (0.7, 0.6),
}


def close_up(name: str, height_m: float, size_m: float) -> Shot:
    """A window in the lower half of a tree's crown, or on a herb's upper half."""
    share, window_m = CLOSE.get(name, (0.45 if height_m > 2 else 0.7, float(np.clip(0.05 * size_m, 0.12, 0.7))))
    return Shot(VIEW_PX, samples=48, look_at_m=share * height_m, window_m=window_m)


def measure_and_photograph(name: str) -> dict[str, float]:
    """Numbers of a mature plant; its picture goes to docs/pictures/species."""
    began = time.perf_counter()
    plan = plan_of(name, SEED)
    exemplar = mature(plan, name)
    shots = (close_up(name, exemplar.height_m, size_of_m(exemplar)), Shot(VIEW_PX, samples=48, distance_m=FAR_M))
    views = [
        photograph(
            exemplar,
            materials_of(plan.drawn.species),
            camera_of(exemplar, shot),
            plan.drawn.recipe,
            shot.samples,
            SEED,
            Silent(),
        )
        for shot in shots
    ]
    save(np.concatenate(views, axis=1), PICTURES / "species" / f"{name}.jpg")
    sys.stdout.write(f"{name}: {exemplar.triangles:,} triangles, {time.perf_counter() - began:.1f} s\n")
    return numbers_of(plan, exemplar)


def mature(plan: Plan, name: str) -> Exemplar:
    """The plant that is shown."""
    return grow(plan, name, plan.drawn.species[name].ecology.max_radius_m, SEED)


def numbers_of(plan: Plan, exemplar: Exemplar) -> dict[str, float]:
    """What the page's table says of a plant, to four digits."""
    one = described(exemplar, plan.drawn.species[exemplar.species], SEED, {})
    values = {
        "height_m": one.height_m,
        "width_m": one.crown_width_m,
        "leaf_area_m2": one.leaf_area_m2,
        "leaf_area_index": one.leaf_area_index,
        "wood_kg": one.wood_kg,
        "leaf_kg": one.leaf_kg,
    }
    return {
        "triangles": sum(one.triangles.values()),
        **{key: float(f"{value:.4g}") for key, value in values.items()},
    }


def save(picture: np.ndarray, path: Path) -> None:
    """A JPEG of at most `MOST_BYTES`, as good as that allows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for quality in range(92, 40, -4):
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, format="JPEG", quality=quality, optimize=True)
        if buffer.tell() <= MOST_BYTES:
            break
    path.write_bytes(buffer.getvalue())


def contact_sheet() -> None:
    """All species' pictures in rows; the page tells their names."""
    names = [name for name in list_assets("species") if (PICTURES / "species" / f"{name}.jpg").exists()]
    gap = 8
    width, height = 2 * VIEW_PX[0] + gap, VIEW_PX[1] + gap
    rows = -(-len(names) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width - gap, rows * height - gap), (255, 255, 255))
    for number, name in enumerate(names):
        row, column = divmod(number, COLUMNS)
        sheet.paste(Image.open(PICTURES / "species" / f"{name}.jpg"), (column * width, row * height))
    sheet.save(PICTURES / "library.jpg", quality=85, optimize=True)


def main() -> None:
    known = list_assets("species")
    unknown = [name for name in sys.argv[1:] if name not in known]
    if unknown:
        sys.exit(f"no such species: {', '.join(unknown)}; there are {', '.join(known)}")
    numbers = generate.species_numbers()
    for name in sys.argv[1:] or known:
        numbers[name] = measure_and_photograph(name)
        sys.stdout.flush()
        kept = {one: numbers[one] for one in known if one in numbers}
        generate.NUMBERS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    contact_sheet()
    (generate.DOCS / "species.md").write_text(generate.species_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
