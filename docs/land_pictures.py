"""Pictures of ponds and roads, for docs/guide.md; `docs/pictures.py` runs them.

pond.jpg, forest_road.jpg     land     one stand with a pond that mirrors it, and a forest road, at eye level
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from label_pictures import PICTURES
from PIL import Image

RECIPE = """
forestgen: 1
seed: 11
species: {beech: beech, spruce: spruce, grass: grass}
site:
  size_m: [70, 60]
  terrain: {kind: rolling, amplitude_m: 0.6, wavelength_m: 60}
  micro_relief: {rms_m: 0.05}
  surroundings: forest
  water: [{what: pond, position_m: [24, 32], radius_m: 9}]
  paths: [{what: forest_road, points_m: [[50, -30], [54, 20], [48, 50], [56, 90]]}]
  ground:
    layers:
      - {what: fallen_leaves, cover: 0.6}
      - {what: small_plants, species: grass, height_m: 0.2, cover: 0.7, on: roadside}
      - {what: stones, size_m: 0.035, cover: 0.12, on: path}
      - {what: fallen_leaves, cover: 0.05, patch_m: 2, on: water}
community:
  model: stand
  storeys:
    - {species: {beech: 0.5, spruce: 0.5}, stems_per_ha: 420, dominant_height_m: 20, basal_area_m2_per_ha: 25}
sky: {sun: {elevation_deg: 42, azimuth_deg: 200}}
cameras:
  - {name: pond, position_m: [34.5, 27, 1.8], look_at_m: [14, 36, -0.2], hfov_deg: 72, size_px: [480, 320]}
  - {name: forest_road, position_m: [53.2, 9, 1.7], look_at_m: [52.4, 28, 0.3], hfov_deg: 62, size_px: [480, 320]}
render: {samples: 48}
"""


def land(scratch: Path) -> None:
    """A pond and a road."""
    recipe, folder = scratch / "land.yaml", scratch / "land"
    recipe.write_text(RECIPE, encoding="utf-8")
    subprocess.run([sys.executable, "-m", "forestgen", "render", recipe, "-o", folder], check=True)
    for name in ("pond", "forest_road"):
        frame = next(folder.glob(f"*/*-{name}"))
        Image.open(frame / "preview.png").convert("RGB").save(PICTURES / f"{name}.jpg", quality=86)
        sys.stdout.write(f"{PICTURES / f'{name}.jpg'}\n")
