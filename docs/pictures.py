"""Renders the documentation's pictures: `uv run python docs/pictures.py` (some six minutes on two cores).

quickstart.jpg   the quickstart's view, larger and with more samples; the right half under its instance mask
succession.jpg   four stages of Lane's succession (2002, Figure 4.5): maps, and the stand as a camera sees it
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
STAGES = (20, 150, 300, 1000)


def render(folder: Path, *settings: str) -> Path:
    """Render the quickstart with some settings; the frame's folder."""
    options = [word for setting in settings for word in ("--set", setting)]
    recipe = ROOT / "recipes" / "quickstart.yaml"
    subprocess.run([sys.executable, "-m", "forestgen", "render", recipe, "-o", folder, *options], check=True)
    return next(path for path in sorted(folder.iterdir()) if path.is_dir())


def quickstart(scratch: Path) -> None:
    frame = render(scratch / "quickstart", "cameras.0.size_px=[1280, 720]")
    picture = np.asarray(Image.open(frame / "preview.png")).copy()
    labels = np.asarray(Image.open(frame / "overlay.png"))
    half = picture.shape[1] // 2
    picture[:, half:] = labels[:, half:]
    picture[:, half - 1 : half + 1] = 255
    save(picture, "quickstart.jpg")


def succession(scratch: Path) -> None:
    recipe = ROOT / "recipes" / "quickstart.yaml"
    maps = [word for step in STAGES for word in ("--map-step", str(step))]
    folder = scratch / "community"
    command = [sys.executable, "-m", "forestgen", "simulate", recipe, "-o", folder, *maps]
    subprocess.run([*command, "--set", f"community.steps={STAGES[-1]}"], check=True)
    rows = []
    for step in STAGES:
        view = "cameras.0={position_m: [60, -34, 14], look_at_m: [60, 60, 4], size_px: [720, 360], hfov_deg: 62}"
        frame = render(scratch / f"stage-{step}", f"community.steps={step}", view, "render.samples=12")
        chart = Image.open(folder / f"map-{step:06d}.png").convert("RGB")
        chart = chart.resize((round(chart.width * 360 / chart.height), 360), Image.Resampling.LANCZOS)
        rows.append(np.concatenate([np.asarray(chart), np.asarray(Image.open(frame / "preview.png"))], axis=1))
    save(np.concatenate(rows, axis=0), "succession.jpg")


def save(picture: np.ndarray, name: str) -> None:
    PICTURES.mkdir(exist_ok=True)
    Image.fromarray(picture).save(PICTURES / name, quality=88, optimize=True)
    sys.stdout.write(f"{PICTURES / name}\n")


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        quickstart(Path(scratch))
        succession(Path(scratch))


if __name__ == "__main__":
    main()
