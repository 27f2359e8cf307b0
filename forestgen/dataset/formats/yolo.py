"""yolo/: the layout that YOLO trainers load, once with outlines and once with boxes.

    yolo/segmentation/data.yaml, images/FRAME.png, labels/FRAME.txt     class x1 y1 x2 y2 ...
    yolo/boxes/data.yaml, images/FRAME.png, labels/FRAME.txt            class cx cy w h

A line is a plant that wins a pixel of the instance mask, by rising plant_id; lengths are shares of the image's width
and height; a class is coco.json's category less 1. An image without plants has an empty file. `train` and `val` of
data.yaml both name all images, the same ones: a score on val says nothing until they are split as the task asks. A
batch with the splits train and val has, beside them, yolo_segmentation.yaml and yolo_boxes.yaml, which name each
split's own images: train with those.

What the format cannot hold: plant_id (a line's number is the annotation's place among its image's in coco.json), and
any label besides class and outline.

**One polygon a plant.** A line has one ring, but a crown is many pieces with gaps. The ring goes through border pixels,
as those of OpenCV's findContours do, around pieces and holes, and crosses gaps by bridges (`contours.py`). Its mask is
that of OpenCV's fillPoly, which Ultralytics and supervision use: pixels whose centre lies inside by the even-odd rule,
and pixels on the ring's lines. That is the instance mask, but for pixels under bridges, and for pieces that are left
out because their bridges would add more pixels than they have. A plant in one piece, holes included, is
exact. A ring's own box is a pixel smaller than the mask's, and lacks what is left out: take the boxes of
``yolo/boxes``. For masks as they are, read coco.json.

Shares are those of the pixel's column and row plus 0.4: times the width or height, cut off or rounded, they give that
pixel, in single precision too. A ring of one or two pixels repeats its last one, for a line has three corners at least.

Files in the frame's folder: ``yolo_segmentation.txt`` and ``yolo_boxes.txt``; merging places them, and the preview.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from forestgen.dataset.files import make_folder, write_bytes
from forestgen.dataset.formats.contours import polygons
from forestgen.dataset.formats.format import DatasetFormat, damaged, in_order, place, read_bytes
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame

FOLDER_NAME = "yolo"
TASKS = ("segmentation", "boxes")
_SPLIT_FILES = {task: f"yolo_{task}.yaml" for task in TASKS}
_DIGITS = 7
_WITHIN_PIXEL = 0.4  # below 0.5, so that rounding gives the pixel; near it, for its centre is meant
_FEWEST_CORNERS = 3


class Yolo(DatasetFormat):
    """Outlines and boxes for YOLO trainers."""

    name = "yolo"
    check_module = "forestgen.dataset.check.yolo"
    bytes_per_pixel, bytes_per_plant = 6, 2000
    split_file_names = tuple(_SPLIT_FILES.values())

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's lines of both tasks into its folder; a failure raises `OutputError`."""
        for task, lines in zip(TASKS, (outline_lines(labelled), box_lines(labelled)), strict=True):
            write_bytes(folder / f"yolo_{task}.txt", "".join(line + "\n" for line in lines).encode())

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Place images and labels of all frames where trainers look for them, and write data.yaml."""
        frames = in_order(folders)
        for task in TASKS:
            home = root / FOLDER_NAME / task
            make_folder(home / "images")
            make_folder(home / "labels")
            for folder in frames:
                shard = root / folder / f"yolo_{task}.txt"
                text = read_bytes(shard)
                if text and not text.endswith(b"\n"):  # it ends within a line
                    raise damaged(shard)
                place(shard, home / "labels" / f"{folder}.txt")
                place(root / folder / "preview.png", home / "images" / f"{folder}.png")
            write_bytes(home / "data.yaml", f"train: images\nval: images\n{_names(settings)}".encode())

    def split_files(self, splits: Sequence[str], settings: DatasetSettings) -> dict[str, bytes]:
        """Each task's yaml, with the images of each split; none without a val."""
        if not {"train", "val"} <= set(splits):
            return {}
        files = {}
        for task in TASKS:
            images = "".join(f"{json.dumps(split)}: {split}/{FOLDER_NAME}/{task}/images\n" for split in splits)
            files[_SPLIT_FILES[task]] = (images + _names(settings)).encode()
        return files


FORMAT = Yolo()


def _names(settings: DatasetSettings) -> str:
    """The classes of a trainer's yaml."""
    quoted = (json.dumps(name, ensure_ascii=False) for name in settings.category_names)
    return "names:\n" + "".join(f"  {number}: {name}\n" for number, name in enumerate(quoted))


def outline_lines(labelled: LabelledFrame) -> list[str]:
    """``class x1 y1 x2 y2 ...`` of each plant that wins a pixel."""
    width, height = labelled.frame.camera.size_px
    across, down = _shares(width), _shares(height)
    rings = polygons(labelled.pixels.instance)
    visible = labelled.views.visible
    lines = []
    for row in np.flatnonzero(visible.has_box):
        ring = rings[int(visible.plant_id[row])].tolist()
        ring += ring[-1:] * (_FEWEST_CORNERS - len(ring))
        corners = " ".join(f"{across[x]} {down[y]}" for x, y in ring)
        lines.append(f"{labelled.category[row]} {corners}")
    return lines


def box_lines(labelled: LabelledFrame) -> list[str]:
    """``class cx cy w h`` of each plant that wins a pixel."""
    visible = labelled.views.visible
    rows = np.flatnonzero(visible.has_box)
    size = np.array(labelled.frame.camera.size_px, dtype=np.float64)
    box = visible.box_px[rows].astype(np.float64)
    shares = np.hstack([(box[:, :2] + box[:, 2:] / 2.0) / size, box[:, 2:] / size])
    return [
        f"{category} " + " ".join(f"{share:.9f}" for share in one)
        for category, one in zip(labelled.category[rows].tolist(), shares.tolist(), strict=True)
    ]


def _shares(length_px: int) -> list[str]:
    """Text of the share of each pixel along a side."""
    return [f"{(pixel + _WITHIN_PIXEL) / length_px:.{_DIGITS}f}" for pixel in range(length_px)]
