"""The data set's folder as a whole: its frames, the manifest, and the files over all images, read once."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from forestgen.core.errors import RecipeError
from forestgen.dataset.check.files import read_json
from forestgen.dataset.check.finding import Finding, UnreadableError
from forestgen.dataset.check.recipe import categories, read_recipe
from forestgen.dataset.safe_path import SafePath, check_folder, is_frame

MANIFEST, COCO, PANOPTIC, TRANSFORMS, BOP = "manifest.json", "coco.json", "panoptic.json", "transforms.json", "bop"
_BOP_FILES = (("camera", "scene_camera.json"), ("gt", "scene_gt.json"), ("info", "scene_gt_info.json"))
_SCHEMA = "forestgen-manifest/"


@dataclass(frozen=True)
class Merged:
    """A data set's folder."""

    root: Path

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """Folders of frames, those that are there and those that the manifest lists, sorted."""
        there = {path.name for path in self.root.iterdir() if is_frame(path.name) and path.is_dir()}
        listed = {name.partition("/")[0] for name in self.listed if "/" in name}
        return tuple(sorted(there | {name for name in listed if is_frame(name)}))

    @cached_property
    def listed(self) -> dict[str, dict[str, Any]]:
        """The manifest's files: path -> bytes and sha256; none where there is no manifest to read."""
        try:
            manifest = self.manifest
        except UnreadableError:
            return {}
        return dict(manifest["files"])

    @cached_property
    def manifest(self) -> dict[str, Any]:
        manifest = read_json(self.root, MANIFEST)
        if not isinstance(manifest, dict) or not str(manifest.get("schema", "")).startswith(_SCHEMA):
            raise UnreadableError(Finding(MANIFEST, "this is no manifest of forestgen", expected=f"schema {_SCHEMA}1"))
        files = manifest.get("files")
        if not isinstance(files, dict) or not all(isinstance(entry, dict) for entry in files.values()):
            expected = "files: path -> bytes, sha256"
            raise UnreadableError(Finding(MANIFEST, "the manifest lists no files", expected=expected))
        return manifest

    def has(self, name: str) -> bool:
        """Whether a file is there, or should be."""
        return name in self.listed or os.path.lexists(self.root / name)

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """What the first frame's drawn recipe says of labels; all frames agree on classes and species."""
        for name in self.frames[:-1]:
            try:
                return read_recipe(self.root, f"{name}/recipe.yaml")
            except UnreadableError:  # which the frame's own check names
                continue
        return read_recipe(self.root, f"{self.frames[-1]}/recipe.yaml")

    @property
    def category_names(self) -> list[str]:
        """Of instances, in order, by the recipe."""
        return categories(self.recipe)[0]

    @cached_property
    def coco(self) -> dict[str, Any]:
        return self._lists(COCO, "images", "annotations", "categories", "licenses")

    @cached_property
    def coco_by_frame(self) -> dict[str, dict[str, Any]]:
        """Frame -> its image and annotations in coco.json."""
        names = {entry["id"]: entry["name"] for entry in self.coco["categories"]}
        frames = {
            folder_of(image["file_name"]): {"image": image, "annotations": [], "categories": names}
            for image in self.coco["images"]
        }
        by_id = {entry["image"]["id"]: entry["annotations"] for entry in frames.values()}
        for one in self.coco["annotations"]:
            if one.get("image_id") in by_id:
                by_id[one["image_id"]].append(one)
        return frames

    @cached_property
    def panoptic(self) -> dict[str, Any]:
        return self._lists(PANOPTIC, "images", "annotations", "categories")

    @cached_property
    def panoptic_by_frame(self) -> dict[str, dict[str, Any]]:
        """Frame -> its annotation in panoptic.json, with the categories' names."""
        names = {entry["id"]: entry["name"] for entry in self.panoptic["categories"]}
        frames = {entry["id"]: folder_of(entry["file_name"]) for entry in self.panoptic["images"]}
        return {frames[one["image_id"]]: {**one, "categories": names} for one in self.panoptic["annotations"]}

    @cached_property
    def transforms_files(self) -> tuple[str, ...]:
        """transforms.json, or transforms-000000.json and so on."""
        there = {path.name for path in self.root.iterdir() if fnmatchcase(path.name, "transforms*.json")}
        listed = {name for name in self.listed if re.fullmatch(r"transforms(-\d+)?\.json", name)}
        return tuple(sorted(there | listed))

    def transforms(self, file: str) -> dict[str, Any]:
        return self._lists(file, "frames")

    @cached_property
    def transforms_by_frame(self) -> dict[str, dict[str, Any]]:
        """Frame -> its entry in its transforms file."""
        return {
            folder_of(frame["file_path"]): {**frame, "file": file}
            for file in self.transforms_files
            for frame in self.transforms(file)["frames"]
        }

    @cached_property
    def bop_scenes(self) -> tuple[str, ...]:
        """Folders of scenes, relative to the root."""
        scenes = {
            scene.name
            for split in _folders_in(SafePath(self.root, BOP))
            for scene in _folders_in(split)
            if any(fnmatchcase(name, "scene_*.json") for name in scene.names())
        }
        listed = {name.rpartition("/")[0] for name in self.listed if re.fullmatch(rf"{BOP}/.*/scene_\w+\.json", name)}
        return tuple(sorted(scenes | listed))

    @cached_property
    def bop_by_frame(self) -> dict[str, dict[str, Any]]:
        """Frame -> its entries in the three files of its scene."""
        found = {}
        for scene in self.bop_scenes:
            files = {key: read_json(self.root, f"{scene}/{name}") for key, name in _BOP_FILES}
            for image, camera in files["camera"].items():
                entries = {key: content[image] for key, content in files.items()}
                found[str(camera["frame"])] = {"scene": scene, "image": image, **entries}
        return found

    def shared(self, frame: str) -> dict[str, Any]:
        """A frame's share of the merged files that can be read; the others are reported by their own checks."""
        return {name: by_frame[frame] for name, by_frame in self._by_frame.items() if frame in by_frame}

    @cached_property
    def _by_frame(self) -> dict[str, Mapping[str, Any]]:
        found: dict[str, Mapping[str, Any]] = {}
        for name, there, attribute in (
            (COCO, self.has(COCO), "coco_by_frame"),
            (PANOPTIC, self.has(PANOPTIC), "panoptic_by_frame"),
            (TRANSFORMS, bool(self.transforms_files), "transforms_by_frame"),
            (BOP, bool(self.bop_scenes), "bop_by_frame"),
        ):
            if not there:
                continue
            try:
                found[name] = getattr(self, attribute)
            except (UnreadableError, KeyError, TypeError, ValueError, AttributeError, IndexError):
                continue
        return found

    def _lists(self, file: str, *keys: str) -> dict[str, Any]:
        """A JSON mapping with lists of mappings under `keys`."""
        content = read_json(self.root, file)
        if not isinstance(content, dict):
            raise UnreadableError(Finding(file, "this is no data set's description", expected="a JSON mapping"))
        for key in keys:
            values = content.get(key)
            if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
                raise UnreadableError(Finding(file, f"{key} is missing or no list", expected="a list of mappings"))
        return content


def _folders_in(folder: SafePath) -> Iterator[SafePath]:
    names = folder.names() if folder.is_folder() else []
    return (one for one in map(folder.__truediv__, names) if one.is_folder())


def folder_of(path: Any) -> str:
    """The frame's folder of a file's path."""
    return str(path).partition("/")[0]


def open_dataset(root: Path) -> Merged:
    """The folder of a data set; any other folder raises `RecipeError` with what it seems to be."""
    check_folder(root, "the folder of a split")
    merged = Merged(root)
    try:
        frames = merged.frames
        inside = sorted(path.name for path in root.iterdir() if (path / MANIFEST).is_file())
    except OSError as error:
        raise RecipeError(f"the folder cannot be read: {error.strerror}", where=str(root)) from error
    if frames:
        return merged
    raise RecipeError(
        "the folder holds no images of forestgen",
        where=str(root),
        expected="folders such as 000000-camera0, as in the folder of a split",
        got=_what_is_there(merged, inside),
        hint=f"{root / inside[0]}" if inside else None,
    )


def _what_is_there(merged: Merged, inside: list[str]) -> str:
    if (merged.root / "frame.exr").is_file():
        return "the folder of one frame: give the folder above it"
    if merged.listed:
        return "a forestgen output without images"
    if inside:
        return f"a folder of outputs, such as {inside[0]}"
    count = sum(1 for _ in merged.root.iterdir())
    return "nothing" if count == 0 else f"{count} other files or folders"
