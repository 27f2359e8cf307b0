"""Grows, measures and photographs the species: `uv run python docs/species_sheet.py` (some ten minutes on two cores).

docs/species.json               numbers of a mature plant of each species that grows alone
docs/pictures/species/NAME.jpg  the plant close up and whole, from 30 m and from a person's height
docs/pictures/library.jpg       these pictures in one sheet, but for models that are no plants (`NO_PLANT`)
docs/species.md                 the page about them, see docs/generate.py

With names behind it, `uv run python docs/species_sheet.py oak daisy`, it does these alone and keeps the others.
"""

from __future__ import annotations

import io
import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import generate
import numpy as np
from PIL import Image

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.api.plants import described
from forestgen.core.progress import Silent
from forestgen.dataset.tonemap import tone_map
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.growing import grow_exemplar
from forestgen.plants.plan import PlantPlan
from forestgen.render.studio import EXPOSURE, PictureSettings, camera_of, photograph, size_of_m
from forestgen.scene.surfaces import materials_of

PICTURES = Path(__file__).parent / "pictures"
SEED = 3
VIEW_PX = (180, 240)
MOST_BYTES = 40_000
COLUMNS = 4
FAR_M = 30.0
FINEST = 2  # detail of the organs in the close picture; numbers and the far picture are of the plant as it comes
NO_PLANT = ("stalk",)  # a green rod for figures and experiments: nobody would know it, or should
TURNED_DEG = {"log": 62.0}  # about the vertical: a log shows its sawn end
# Height looked at as a share of the plant's, and the window's height in metres, where `close_up` shows too little.
CLOSE: dict[str, tuple[float, float]] = {
    "beech": (0.62, 1.2),
    "birch": (0.75, 1.1),
    "bracken": (0.75, 0.5),
    "bramble": (0.6, 0.35),
    "daisy": (0.93, 0.09),
    "fireweed": (0.78, 0.4),
    "grass": (0.75, 0.35),
    "lily": (0.9, 0.3),
    "log": (0.6, 0.75),
    "maple": (0.6, 1.3),
    "oak": (0.78, 1.3),
    "palm": (0.88, 4.5),
    "pine": (0.86, 1.6),
    "poplar": (0.82, 1.0),
    "shrub": (0.6, 0.6),
    "snag": (0.5, 1.2),
    "spruce": (0.72, 1.8),
    "stump": (0.7, 0.6),
}


def close_up(name: str, height_m: float, size_m: float) -> PictureSettings:
    """A window where a tree's crown has many leaves, or on a herb's upper half."""
    share, window_m = CLOSE.get(name, (0.45 if height_m > 2 else 0.7, float(np.clip(0.05 * size_m, 0.12, 0.7))))
    return PictureSettings(VIEW_PX, samples=48, look_at_m=share * height_m, window_m=window_m)


def measure_and_photograph(name: str) -> dict[str, float]:
    """Numbers of a mature plant; its picture goes to docs/pictures/species."""
    began = time.perf_counter()
    plan = plan_of(name, SEED)
    exemplar = mature(plan, name)
    finest = mature(plan_of(name, SEED, FINEST), name)
    shots = (
        (finest, close_up(name, finest.height_m, size_of_m(finest))),
        (exemplar, PictureSettings(VIEW_PX, samples=48, distance_m=FAR_M)),
    )
    views = []
    for plant, shot in shots:
        seen = turned(plant, TURNED_DEG.get(name, 0.0))
        materials, camera = materials_of(plan.drawn.species), camera_of(seen, shot)
        views.append(
            tone_map(photograph(seen, materials, camera, plan.drawn.recipe, shot.samples, SEED, Silent()), EXPOSURE)
        )
    save(np.concatenate(views, axis=1), PICTURES / "species" / f"{name}.jpg")
    sys.stdout.write(f"{name}: {exemplar.triangles:,} triangles, {time.perf_counter() - began:.1f} s\n")
    return numbers_of(plan, exemplar)


def turned(exemplar: Exemplar, angle_deg: float) -> Exemplar:
    """The plant turned about the vertical, as another photographer would see it."""
    if angle_deg == 0.0:
        return exemplar
    sine, cosine = math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]], dtype=np.float32)

    def mesh(old: Mesh) -> Mesh:
        normals = None if old.normals is None else old.normals @ turn
        return replace(old, vertices_m=old.vertices_m @ turn, normals=normals)

    return replace(exemplar, organs=tuple(replace(organ, mesh=mesh(organ.mesh)) for organ in exemplar.organs))


def mature(plan: PlantPlan, name: str) -> Exemplar:
    """The plant that is shown."""
    return grow_exemplar(request_of(plan, name, None, SEED))


def numbers_of(plan: PlantPlan, exemplar: Exemplar) -> dict[str, float]:
    """What the page's table says of a plant, to four digits."""
    one = described(exemplar, plan.drawn.species[exemplar.species], SEED)
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
    """All species' pictures in rows, but for `NO_PLANT`; the page tells their names."""
    shown = [name for name in generate.species_that_grow_alone() if name not in NO_PLANT]
    names = [name for name in shown if (PICTURES / "species" / f"{name}.jpg").exists()]
    gap = 8
    width, height = 2 * VIEW_PX[0] + gap, VIEW_PX[1] + gap
    rows = -(-len(names) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width - gap, rows * height - gap), (255, 255, 255))
    for number, name in enumerate(names):
        row, column = divmod(number, COLUMNS)
        sheet.paste(Image.open(PICTURES / "species" / f"{name}.jpg"), (column * width, row * height))
    sheet.save(PICTURES / "library.jpg", quality=85, optimize=True)


def main() -> None:
    known = generate.species_that_grow_alone()
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
