"""bop/: counts, boxes, fractions, poses and masks of each plant."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from forestgen.dataset.check.files import Finding, finding, read_json, read_picture
from forestgen.dataset.check.frame_data import FrameData, frame_check
from forestgen.dataset.check.merged import Merged, dataset_check
from forestgen.dataset.safe_path import SafePath

_FOLDER = "bop"
_FILES = (("camera", "scene_camera.json"), ("gt", "scene_gt.json"), ("info", "scene_gt_info.json"))
_TOLERANCE = 1e-9


def _scenes(merged: Merged) -> list[str]:
    """Folders of scenes, relative to the root."""
    found = {name.rpartition("/")[0] for name in merged.listed if re.fullmatch(r"bop/.*/scene_\w+\.json", name)}
    for split in _inside(SafePath(merged.root, _FOLDER)):
        for scene in _inside(split):
            if any(re.fullmatch(r".*/scene_[^/]*\.json", one.name) for one in _inside(scene)):
                found.add(scene.name)
    return sorted(found)


def _inside(folder: SafePath) -> list[SafePath]:
    return [folder / name for name in folder.names()] if folder.is_folder() else []


def frame_shares(merged: Merged) -> Mapping[str, Any]:
    """Frame -> its entries in the three files of its scene."""
    found = {}
    for scene in _scenes(merged):
        files = {key: read_json(merged.root, f"{scene}/{name}") for key, name in _FILES}
        for image, camera in files["camera"].items():
            entries = {key: content[image] for key, content in files.items()}
            found[str(camera["frame"])] = {"scene": scene, "image": image, **entries}
    return found


@dataset_check("bop files", _FOLDER, when=lambda merged: bool(_scenes(merged)))
def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame is one image of one scene."""
    shares = frame_shares(merged)
    for name in merged.frames:
        if name not in shares:
            yield finding("a frame is in no scene", "an image", "none", file=f"{_FOLDER}/train_pbr", image=name)


@frame_check("bop", _FOLDER, share=_FOLDER, shared=True)
def plants(frame: FrameData) -> Iterator[Finding]:
    """The plants of the mask by rising id, with the counts of visible and amodal masks, and their pictures."""
    share = frame.shared[_FOLDER]
    scene, image = PurePosixPath(share["scene"]), int(share["image"])
    yield from _camera(frame, share, str(scene / "scene_camera.json"))
    listed = [one["plant_id"] for one in share["gt"]]
    if listed != frame.extents.plant_id.tolist() or len(share["info"]) != len(listed):
        file, problem = str(scene / "scene_gt.json"), "plants are not those of the mask, by rising id"
        differing = sorted(set(listed) ^ set(frame.extents.plant_id.tolist()))
        for plant in differing or [None]:
            yield finding(problem, len(frame.extents.plant_id), len(listed), plant, file=file)
        return
    for row, info in enumerate(share["info"]):
        yield from _info(frame, str(scene / "scene_gt_info.json"), row, info)
        for folder in ("mask", "mask_visib"):
            yield from _mask(frame, str(scene / folder / f"{image:06d}_{row:06d}.png"), folder, row)


def _camera(frame: FrameData, share: dict[str, Any], file: str) -> Iterator[Finding]:
    camera, entry = frame.camera, share["camera"]
    for key, expected in (
        ("cam_K", np.asarray(camera.values["K"], dtype=np.float64).ravel()),
        ("cam_R_w2c", camera.rotation.ravel()),
        ("cam_t_w2c", camera.camera_from_world[:3, 3] * 1000.0),
    ):
        got = np.asarray(entry[key], dtype=np.float64)
        if not np.allclose(got, expected, rtol=1e-6, atol=1e-6):
            yield finding(f"{key} is not camera.json's", expected, got, file=file)


def _info(frame: FrameData, file: str, row: int, info: dict[str, Any]) -> Iterator[Finding]:
    plant = int(frame.extents.plant_id[row])
    table = frame.row_of.get(plant)
    if table is None:
        return
    seen, alone = int(frame.extents.pixels[row]), int(frame.plants["amodal_pixels"][table])
    for key, expected in (
        ("px_count_visib", seen),
        ("px_count_all", alone),
        ("bbox_visib", frame.extents.box_px[row].tolist()),
        ("bbox_obj", [int(frame.plants[f"amodal_box_{side}"][table]) for side in "xywh"]),
    ):
        if info[key] != expected:
            yield finding(f"{key} is not the mask's", expected, info[key], plant, file=file)
    fraction, valid = info["visib_fract"], info["px_count_valid"]
    if not abs(fraction - seen / alone) <= _TOLERANCE:
        yield finding("visib_fract is not px_count_visib / px_count_all", seen / alone, fraction, plant, file=file)
    if not 0 <= valid <= info["px_count_all"]:
        most = f"0 to {info['px_count_all']}"
        yield finding("px_count_valid is more than px_count_all", most, valid, plant, file=file)


def _mask(frame: FrameData, file: str, folder: str, row: int) -> Iterator[Finding]:
    plant = int(frame.extents.plant_id[row])
    mask = read_picture(frame.root, file)
    if mask.shape != frame.instance.shape or not np.isin(mask, (0, 255)).all():
        yield finding("this is no mask of the image's size", "0 and 255", mask.shape, plant, file=file)
        return
    own = frame.instance == plant
    wrong = (mask != 0) != own if folder == "mask_visib" else own & (mask == 0)
    if wrong.any():
        line, column = np.argwhere(wrong)[0].tolist()
        problem = {"mask": "a visible pixel is outside the mask"}.get(folder, "the mask is not the instance mask")
        yield finding(problem, plant_id=plant, pixel=(column, line), file=file)
    if folder == "mask" and plant in frame.row_of:
        expected, got = int(frame.plants["amodal_pixels"][frame.row_of[plant]]), int(np.count_nonzero(mask))
        if expected != got:
            yield finding("the mask has another area than amodal_pixels", expected, got, plant, file=file)


FRAME_CHECKS, DATASET_CHECKS = (plants,), (structure,)
