"""A picture of the page that `forestgen report` makes; `docs/pictures.py` runs it.

report.jpg    report    the top of a small data set's page, in Debian's chromium
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
TARGET = ROOT / "docs" / "pictures" / "report.jpg"
IMAGES, SIZE_PX = 10, (1200, 1180)
SETTINGS = ("render.samples=12", "plants.library=2", "plants.exemplars_per_species=3")


def report(scratch: Path) -> None:
    """Some images of recipes/sapling_stand.yaml, and a photograph of their report."""
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    recipe, folder = ROOT / "recipes" / "sapling_stand.yaml", scratch / "saplings"
    command = [sys.executable, "-m", "forestgen", "batch", str(recipe), "--count", str(IMAGES), "--out", str(folder)]
    subprocess.run([*command, *settings], check=True)
    photograph(folder / "report.html", scratch / "page.png")


def photograph(page: Path, scratch: Path) -> None:
    """The top of a page."""
    browser = shutil.which("chromium")
    if browser is None:
        raise SystemExit("docs/report_picture.py needs chromium")
    width, height = SIZE_PX
    options = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--window-size={width},{height}"]
    command = [browser, *options, f"--screenshot={scratch}", page.resolve().as_uri()]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)  # which it fills with what it misses of a desktop
    Image.open(scratch).convert("RGB").save(TARGET, quality=86, optimize=True)
    sys.stdout.write(f"{TARGET}\n")


PICTURES_OF = {"report": report}
