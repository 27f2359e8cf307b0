"""Others read what we write: `uv run python benchmarks/readers.py --peer-python PATH [FOLDER]`; exit code 1 if not.

FOLDER is a split of a data set with the formats coco and yolo, such as outputs/forests/train; without it, the
quickstart's recipe is rendered, small. PATH is the interpreter of an environment with supervision (and OpenCV, which it
fills polygons with):

    uv venv readers && uv pip install --python readers/bin/python supervision opencv-python-headless pillow
    uv run python benchmarks/readers.py --peer-python readers/bin/python

1. pycocotools, installed here: every mask of coco.json is that of instance.png. Bound: all pixels.
2. supervision, COCO: masks, boxes and classes. Bound: all pixels, exact boxes.
3. supervision, YOLO boxes. Bound: 1e-3 pixels.
4. supervision, YOLO outlines, which one ring cannot hold exactly: bridges add pixels, and pieces are left out. Bound:
   mean intersection over union 0.75. Printed: pixels missing and added, by the plants' own.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from support.data_sets import read_instance

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = ("render.samples=1", "cameras.0.size_px=[320, 180]", "dataset.formats=[coco, yolo]", "images=2")
BOX_BOUND_PX = 1e-3
IOU_BOUND = 0.75
PEER = r"""
import json, sys
from pathlib import Path
import numpy as np
import supervision as sv
from PIL import Image

root = Path(sys.argv[1])

def truth(name):
    rgb = np.asarray(Image.open(root / name / "instance.png").convert("RGB")).astype(np.int64)
    ids = rgb @ [1, 256, 65536]
    masks = np.array([ids == plant for plant in np.unique(ids) if plant]).reshape(-1, *ids.shape)
    boxes = [[x.min(), y.min(), x.max() + 1, y.max() + 1] for y, x in map(np.nonzero, masks)]
    return masks, np.array(boxes, float).reshape(-1, 4)

def yolo(task):
    home = root / "yolo" / task
    return sv.DetectionDataset.from_yolo(str(home / "images"), str(home / "labels"), str(home / "data.yaml"))

coco = sv.DetectionDataset.from_coco(str(root), str(root / "coco.json"), force_masks=True)
frames = {Path(path).parent.name: found for path, _, found in coco}
boxes = {Path(path).stem: found for path, _, found in yolo("boxes")}
outlines = {Path(path).stem: found for path, _, found in yolo("segmentation")}
assert set(frames) == set(boxes) == set(outlines), (set(frames), set(boxes), set(outlines))
out = {"version": sv.__version__, "images": len(frames), "plants": 0, "coco_pixels": 0, "coco_box_px": 0.0,
       "yolo_box_px": 0.0, "classes": 0, "missing": 0, "added": 0, "pixels": 0}
shares = []
for name, found in sorted(frames.items()):
    masks, box = truth(name)
    if not len(masks):
        assert not len(found) and not len(boxes[name]) and not len(outlines[name]), name
        continue
    assert len(found) == len(boxes[name]) == len(outlines[name]) == len(masks), name
    out["plants"] += len(masks)
    out["coco_pixels"] += int((found.mask != masks).sum())
    out["coco_box_px"] = max(out["coco_box_px"], float(np.abs(found.xyxy - box).max()))
    out["yolo_box_px"] = max(out["yolo_box_px"], float(np.abs(boxes[name].xyxy - box).max()))
    for other in (boxes[name], outlines[name]):
        out["classes"] += int((other.class_id != found.class_id).sum())
    filled = outlines[name].mask
    out["missing"] += int((masks & ~filled).sum())
    out["added"] += int((filled & ~masks).sum())
    out["pixels"] += int(masks.sum())
    shares += ((filled & masks).sum(axis=(1, 2)) / (filled | masks).sum(axis=(1, 2))).tolist()
out["iou"] = float(np.mean(shares)) if shares else 1.0
print(json.dumps(out))
"""


def wrong_pixels_of_pycocotools(folder: Path) -> tuple[int, int]:
    """Masks that pycocotools decodes, and their pixels that differ from instance.png."""
    from pycocotools.coco import COCO

    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO(str(folder / "coco.json"))
    masks, wrong = 0, 0
    for image in coco.loadImgs(coco.getImgIds()):
        instance = read_instance((folder / image["file_name"]).with_name("instance.png"))
        left = instance != 0
        for one in coco.loadAnns(coco.getAnnIds(imgIds=image["id"])):
            mask = coco.annToMask(one).astype(bool)
            wrong += int((mask != (instance == one["plant_id"])).sum())
            left &= ~mask
            masks += 1
        wrong += int(left.sum())
    return masks, wrong


def by_supervision(python: str, folder: Path) -> dict[str, Any]:
    """What the peer script found."""
    done = subprocess.run([python, "-c", PEER, str(folder)], check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def rendered(folder: Path) -> Path:
    recipe = ROOT / "recipes" / "quickstart.yaml"
    options = [word for setting in SETTINGS for word in ("--set", setting)]
    command = [sys.executable, "-m", "forestgen", "render", str(recipe), "-o", str(folder / "out"), *options]
    subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    return folder / "out" / "train"


def report(line: str, value: object, good: bool) -> bool:
    print(f"{'ok ' if good else 'BAD'} {line:<58} {value}")
    return good


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--peer-python")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        folder = rendered(Path(home)) if options.folder is None else options.folder
        masks, wrong = wrong_pixels_of_pycocotools(folder)
        good = [report(f"pycocotools: wrong pixels of {masks} masks", wrong, wrong == 0)]
        if options.peer_python is None:
            print("no --peer-python: supervision was not asked")
            return int(not all(good))
        found = by_supervision(options.peer_python, folder)
    name = f"supervision {found['version']}"
    print(f"{name}: {found['images']} images, {found['plants']} plants")
    good += [
        report("COCO: wrong pixels", found["coco_pixels"], found["coco_pixels"] == 0),
        report("COCO: largest error of a box, pixels", found["coco_box_px"], found["coco_box_px"] == 0.0),
        report("YOLO: classes that are not COCO's", found["classes"], found["classes"] == 0),
        report("YOLO: largest error of a box, pixels", found["yolo_box_px"], found["yolo_box_px"] <= BOX_BOUND_PX),
        report("YOLO: mean intersection by union of filled outlines", f"{found['iou']:.3f}", found["iou"] >= IOU_BOUND),
    ]
    for what in ("missing", "added"):
        print(f"    {f'YOLO: pixels {what}, by the plants own':<58} {found[what] / max(found['pixels'], 1):.3f}")
    return int(not all(good))


if __name__ == "__main__":
    sys.exit(main())
