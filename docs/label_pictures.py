"""Pictures of labels, for docs/labels.md; `docs/pictures.py` runs them.

labels.jpg    labels    one view and its labels, a panel each
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from forestgen.dataset.exr import read_exr
from forestgen.dataset.png import class_palette

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
SIZE_PX = (480, 270)
GAP_PX, COLUMNS = 4, 3
SETTINGS = (
    f"cameras.0={{position_m: [60, -34, 14], look_at_m: [60, 60, 10], size_px: {list(SIZE_PX)}, hfov_deg: 62}}",
    "cameras.0.path={frames: 2, frames_per_s: 12, position_m: [[60.2, -33.5, 14]], look_at_m: [[60, 60, 10]]}",
    "wind.speed_m_per_s=9",
    "render.samples=48",
)
PART_RGB = np.array(
    [
        *([110, 160, 220], [122, 96, 70], [88, 54, 36], [170, 110, 70], [86, 150, 66], [220, 90, 160]),
        *([230, 60, 50], [130, 130, 130], [150, 120, 60], [160, 160, 170], [60, 110, 190]),
    ],
    dtype=np.uint8,
)

Picture = NDArray[np.uint8]


def labels(scratch: Path) -> None:
    """One view and its labels."""
    recipe, folder = ROOT / "recipes" / "quickstart.yaml", scratch / "labels"
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    command = [sys.executable, "-m", "forestgen", "render", str(recipe), "-o", str(folder), *settings]
    subprocess.run(command, check=True)
    panels = panels_of(min(path.parent for path in folder.glob("train/*/preview.png")))
    rows = [list(panels.items())[k : k + COLUMNS] for k in range(0, len(panels), COLUMNS)]
    width, height = SIZE_PX
    across, down = COLUMNS * (width + GAP_PX) - GAP_PX, len(rows) * (height + GAP_PX) - GAP_PX
    sheet = Image.new("RGB", (across, down), "white")
    for j, row in enumerate(rows):
        for i, (title, picture) in enumerate(row):
            sheet.paste(titled(picture, title), (i * (width + GAP_PX), j * (height + GAP_PX)))
    sheet.save(PICTURES / "labels.jpg", quality=78, optimize=True)
    sys.stdout.write(f"{PICTURES / 'labels.jpg'}\n")


def panels_of(frame: Path) -> dict[str, Picture]:
    """Title -> picture of each label of a frame."""
    parts = read_exr(frame / "frame.exr")
    preview = np.asarray(Image.open(frame / "preview.png").convert("RGB"))
    identity, depth = parts["identity"], parts["depth"]["Z"]
    classes = int(identity["semantic"].max()) + 1
    far = np.nanpercentile(depth[np.isfinite(depth)], 98)
    near = np.where(np.isfinite(depth), np.clip(depth / far, 0, 1), 1.0)
    return {
        "preview": preview,
        "instance, over the preview": np.asarray(Image.open(frame / "overlay.png").convert("RGB")),
        "amodal mask and keypoints": amodal(frame, preview),
        "semantic": class_palette(classes)[identity["semantic"]],
        "part": PART_RGB[identity["part"]],
        "occlusion boundaries": grey(1.0 - 0.9 * parts["boundary"]["occluding"]),
        "depth": grey(1.0 - np.sqrt(near)),
        "shading normal": grey(0.5 + 0.5 * stacked(parts["normal.shading"], "XYZ")),
        "albedo": grey(np.clip(stacked(parts["albedo"], "RGB") * 1.5, 0, 1) ** (1 / 2.2)),
        "sun visible": grey(0.08 + 0.9 * parts["sun"]["visible"]),
        "cloud opacity": grey(parts["cloud"]["opacity"]),
        "motion to the next frame": flow(parts["motion"]["forward.u"], parts["motion"]["forward.v"]),
    }


def stacked(part: dict[str, NDArray[Any]], names: str) -> NDArray[np.float64]:
    return np.stack([part[name].astype(np.float64) for name in names], axis=-1)


def grey(values: NDArray[Any]) -> Picture:
    """(H, W) or (H, W, 3) numbers from 0 to 1."""
    shade = np.rint(np.clip(np.nan_to_num(values), 0, 1) * 255).astype(np.uint8)
    return shade if shade.ndim == 3 else np.repeat(shade[..., None], 3, axis=2)


def flow(right: NDArray[np.float32], down: NDArray[np.float32]) -> Picture:
    """Direction as hue, length as saturation."""
    from matplotlib.colors import hsv_to_rgb

    length = np.hypot(right, down)
    most = np.nanpercentile(length, 98)
    hue = (np.arctan2(down, right) / (2 * np.pi)) % 1.0
    colour = np.stack([hue, np.clip(length / most, 0, 1), np.ones_like(hue)], axis=-1)
    return grey(hsv_to_rgb(np.nan_to_num(colour)))


def amodal(frame: Path, preview: Picture) -> Picture:
    """The largest plant that is half hidden: what is seen of it in yellow, what is not in red, and its keypoints."""
    from pycocotools import mask

    shots = json.loads((frame / "annotations.json").read_text(encoding="utf-8"))["annotations"]
    half = [one for one in shots if 0.3 < one["visible_fraction"] < 0.7 and one["truncation"] == 0.0]
    one = max(half, key=lambda shot: shot["amodal_area"])
    seen, whole = (mask.decode(one[key]).astype(bool) for key in ("segmentation", "amodal_segmentation"))
    picture = preview * 0.45
    picture[seen] = 0.3 * picture[seen] + 0.7 * np.array([250, 210, 60])
    picture[whole & ~seen] = 0.4 * picture[whole & ~seen] + 0.6 * np.array([225, 60, 50])
    image = Image.fromarray(picture.astype(np.uint8))
    draw = ImageDraw.Draw(image)
    x, y, w, h = one["amodal_bbox"]
    draw.rectangle((x, y, x + w, y + h), outline="white")
    points = np.reshape(one["keypoints"], (-1, 3))
    for px, py, state in points[points[:, 2] > 0]:
        draw.ellipse((px - 4, py - 4, px + 4, py + 4), fill="white" if state == 2 else None, outline="white", width=2)
    return np.asarray(image)


def titled(picture: Picture, title: str) -> Image.Image:
    image = Image.fromarray(np.ascontiguousarray(picture))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(15)
    left, top, right, bottom = draw.textbbox((8, 6), title, font=font)
    draw.rectangle((left - 5, top - 4, right + 5, bottom + 4), fill=(0, 0, 0))
    draw.text((8, 6), title, fill="white", font=font)
    return image
