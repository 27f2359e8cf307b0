"""Single breaks of a data set, and what the checker must say of each: see `test_labels_check`."""

from __future__ import annotations

import numpy as np
from label_breaks import (
    BIRCH,
    FRAME,
    HIDDEN,
    NEXT,
    Break,
    all_of,
    annotation,
    cell,
    content,
    cut,
    exr,
    gone,
    lines,
    moved,
    numbers,
    picture,
    points,
    short_palette,
    table,
    text,
    turned_mask,
    untold,
    without_row,
)

SCENE = "bop/train_pbr/000000"


def own(name: str) -> str:
    """A file of the frame that is broken."""
    return f"{FRAME}/{name}"


def half_of_the_outline(row: str) -> str:
    """A line of YOLO with the first half of its points."""
    kind, *numbers = row.split()
    return " ".join([kind, *numbers[: len(numbers) // 4 * 2]])


# name: (check, file, the break, what else the finding says)
MUTATIONS: dict[str, tuple[str, str, Break, dict[str, object]]] = {
    # files that cannot be read
    "an EXR cut short": ("files", own("frame.exr"), cut(own("frame.exr")), {}),
    "an EXR that is none": ("files", own("frame.exr"), text(own("frame.exr"), "no EXR"), {}),
    "an empty EXR": ("files", own("frame.exr"), text(own("frame.exr"), ""), {}),
    "a PNG cut short": ("files", own("instance.png"), cut(own("instance.png")), {}),
    "a preview that is missing": ("files", own("preview.png"), gone(own("preview.png")), {}),
    "a table cut short": ("files", own("plants.parquet"), cut(own("plants.parquet")), {}),
    "a camera that is no JSON": ("files", own("camera.json"), text(own("camera.json"), "{"), {}),
    "a camera without K": ("files", own("camera.json"), content(own("camera.json"), lambda c: c.pop("K")), {}),
    "a recipe cut short": ("files", own("recipe.yaml"), cut(own("recipe.yaml"), 0.01), {}),
    "coco.json cut short": ("coco files", "coco.json", cut("coco.json"), {}),
    "coco.json missing": ("manifest", "coco.json", gone("coco.json"), {}),
    "coco.json without images": ("coco files", "coco.json", content("coco.json", lambda c: c.pop("images")), {}),
    "coco.json as a list": ("coco files", "coco.json", text("coco.json", "[1, 2]"), {}),
    "a manifest cut short": ("manifest", "manifest.json", cut("manifest.json"), {}),
    "a manifest missing": ("manifest", "manifest.json", gone("manifest.json"), {}),
    # masks
    "instance.png, a pixel": (
        *("instance", own("instance.png")),
        picture(own("instance.png"), (HIDDEN, 0, 0), "birch"),
        {"spot": "birch", "plant_id": BIRCH, "got": str(HIDDEN)},
    ),
    "semantic.png, a pixel": ("semantic", own("semantic.png"), picture(own("semantic.png"), 1, "sky"), {"spot": "sky"}),
    "semantic.png of 4 bits a pixel": (
        *("semantic", own("semantic.png")),
        short_palette(own("semantic.png")),
        {"expected": "8", "got": "4"},
    ),
    "the semantic channel and its picture": (
        *("semantic", own("frame.exr")),
        all_of(exr("identity", "semantic", 2, "birch"), picture(own("semantic.png"), 2, "birch")),
        {"spot": "birch", "expected": "3", "got": "2"},
    ),
    "a part of the sky on a plant": ("part", own("frame.exr"), exr("identity", "part", 0, "birch"), {"spot": "birch"}),
    "a leaf of no plant": ("part", own("frame.exr"), exr("identity", "part", 4, "ground"), {"spot": "ground"}),
    "an id that no table holds": (
        *("ids", own("plants.parquet")),
        all_of(exr("identity", "plant_id", 77, "birch"), picture(own("instance.png"), (77, 0, 0), "birch")),
        {"spot": "birch", "plant_id": 77},
    ),
    "two ids swapped in both masks": (
        *("coverage", own("frame.exr")),
        all_of(
            exr("identity", "plant_id", HIDDEN, "mixed"),
            picture(own("instance.png"), (HIDDEN, 0, 0), "mixed"),
            exr("identity", "semantic", 2, "mixed"),
            picture(own("semantic.png"), 2, "mixed"),
        ),
        {"spot": "mixed"},
    ),
    # names of numbers
    "semantic.png without names": ("names", own("semantic.png"), untold(own("semantic.png")), {}),
    "classes.json, a class": (
        *("classes.json", "classes.json"),
        content("classes.json", lambda c: c["semantic"].update({"3": "spruce"})),
        {},
    ),
    "classes.json, a colour": (
        *("classes.json", "classes.json"),
        content("classes.json", lambda c: c["semantic_colours"].update({"3": [0, 0, 0]})),
        {},
    ),
    "classes.json without parts": (
        "classes.json",
        "classes.json",
        content("classes.json", lambda c: c.pop("part")),
        {},
    ),
    # coverage
    "a coverage of 1.01": (
        "coverage",
        own("frame.exr"),
        exr("coverage", "rank0.coverage", 1.01, "sky"),
        {"spot": "sky"},
    ),
    "a coverage that is no number": (
        *("coverage", own("frame.exr")),
        exr("coverage", "rank1.coverage", np.nan, "mixed"),
        {"spot": "mixed"},
    ),
    "a coverage too small": (
        *("coverage", own("frame.exr")),
        exr("coverage", "rank0.coverage", 0.9375, "ground"),
        {"spot": "ground", "got": "0.9375"},
    ),
    "rank 0 of another plant": (
        "coverage",
        own("frame.exr"),
        exr("coverage", "rank0.id", 2, "birch"),
        {"spot": "birch"},
    ),
    "a second rank of one plant": (
        *("coverage", own("frame.exr")),
        exr("coverage", "rank1.id", BIRCH, "mixed"),
        {"spot": "mixed"},
    ),
    # plants.parquet
    "a row deleted": ("ids", own("plants.parquet"), without_row(BIRCH), {"plant_id": BIRCH}),
    "a row twice": ("ids", own("plants.parquet"), cell("plant_id", BIRCH, 2), {"plant_id": BIRCH}),
    "another species' name": ("ids", own("plants.parquet"), cell("species", "oak"), {"plant_id": BIRCH, "got": "oak"}),
    "species of another plant": ("semantic", own("frame.exr"), cell("species", "fireweed"), {"plant_id": BIRCH}),
    "visible_pixels": ("plants", own("plants.parquet"), cell("visible_pixels", 3), {"plant_id": BIRCH, "got": "3"}),
    "a box one pixel wider": (
        *("plants", own("plants.parquet")),
        table(lambda c: c["box_w"].__setitem__(0, c["box_w"][0] + 1)),
        {"plant_id": BIRCH},
    ),
    "a box of a plant out of view": ("plants", own("plants.parquet"), cell("box_x", 3, 5), {"plant_id": 5}),
    "truncated": ("plants", own("plants.parquet"), cell("truncated", False), {"plant_id": BIRCH}),
    "visible_area_px": ("areas", own("plants.parquet"), cell("visible_area_px", 1.0), {"plant_id": BIRCH}),
    "visible_area_px without a number": (
        "areas",
        own("plants.parquet"),
        cell("visible_area_px", None),
        {"plant_id": BIRCH},
    ),
    "stem_pixels": ("stems", own("plants.parquet"), cell("stem_pixels", 999), {"plant_id": BIRCH}),
    "a height that is no number": ("measures", own("plants.parquet"), cell("height_m", None), {"plant_id": BIRCH}),
    "a keypoint's state": ("keypoints", own("plants.parquet"), cell("tip_state", 2), {"plant_id": BIRCH}),
    "amodal pixels below the visible": ("amodal", own("plants.parquet"), cell("amodal_pixels", 5), {"plant_id": BIRCH}),
    "an amodal box that is smaller": ("amodal", own("plants.parquet"), cell("amodal_box_w", 2), {"plant_id": BIRCH}),
    "a visible fraction above 1": ("amodal", own("plants.parquet"), cell("visible_fraction", 1.2), {"plant_id": BIRCH}),
    "a truncation": ("amodal", own("plants.parquet"), cell("truncation", 0.9), {"plant_id": BIRCH}),
    # geometry
    "depth 1% too long": ("depth", own("frame.exr"), exr("depth", "Z", lambda z: z * 1.01), {}),
    "depth and distance 1% too long": (
        *("position", own("frame.exr")),
        all_of(exr("depth", "Z", lambda z: z * 1.01), exr("depth", "distance", lambda z: z * 1.01)),
        {},
    ),
    "a depth that is no number": ("depth", own("frame.exr"), exr("depth", "Z", np.nan, "ground"), {"spot": "ground"}),
    "a distance": ("position", own("frame.exr"), exr("depth", "distance", 99, "ground"), {"spot": "ground"}),
    "a position": ("position", own("frame.exr"), exr("position", "X", lambda x: x + 0.1, "birch"), {"spot": "birch"}),
    "a position in the sky": ("sky", own("frame.exr"), exr("position", "X", 0, "sky"), {}),
    "a finite sky": ("depth", own("frame.exr"), exr("depth", "Z", 5, "sky"), {"spot": "sky"}),
    "a normal of length 1.2": ("normals", own("frame.exr"), exr("normal", "Z", 1.2, "ground"), {"spot": "ground"}),
    "normals away from the camera": (
        *("normals", own("frame.exr")),
        all_of(
            *(
                exr(f"normal{kind}", axis, lambda n: -n, "ground")
                for kind in ("", ".shading", ".camera", ".shading.camera")
                for axis in "XYZ"
            )
        ),
        {"spot": "ground"},
    ),
    "a normal in the camera's axes": (
        *("normals", own("frame.exr")),
        exr("normal.camera", "Y", 0.5, "ground"),
        {"spot": "ground"},
    ),
    "the centre's plant": (
        "centre",
        own("frame.exr"),
        exr("identity", "centre.plant_id", 77, "birch"),
        {"spot": "birch"},
    ),
    "the centre's exemplar": (
        *("centre", own("frame.exr")),
        exr("identity", "centre.exemplar", 9, "birch"),
        {"spot": "birch", "plant_id": BIRCH},
    ),
    "a pose": ("camera", own("camera.json"), content(own("camera.json"), moved), {}),
    "a position beside the pose": (
        *("camera", own("camera.json")),
        content(own("camera.json"), lambda c: c["position_m"].__setitem__(0, 5.0)),
        {},
    ),
    "a share in Cryptomatte": (
        *("cryptomatte", own("cryptomatte.exr")),
        exr("", "CryptoPlant00.G", 0.01, "birch", "cryptomatte.exr"),
        {"spot": "birch", "plant_id": BIRCH},
    ),
    "an id in Cryptomatte": (
        *("cryptomatte", own("cryptomatte.exr")),
        exr("", "CryptoPlant00.R", 1.5, "birch", "cryptomatte.exr"),
        {"spot": "birch"},
    ),
    # light and motion
    "negative radiance": ("radiance", own("frame.exr"), exr("radiance", "R", -1, "ground"), {"spot": "ground"}),
    "sun on the sky": ("light", own("frame.exr"), exr("sun", "visible", 1, "sky"), {"spot": "sky"}),
    "half an opacity too much": ("light", own("frame.exr"), exr("cloud", "opacity", 1.5, "sky"), {"spot": "sky"}),
    "an albedo of 2": ("light", own("frame.exr"), exr("albedo", "G", 2, "birch"), {"spot": "birch"}),
    "motion of the ground": (
        *("motion", own("frame.exr")),
        exr("motion", "forward.u", lambda u: u + 0.5, "ground"),
        {"spot": "ground"},
    ),
    "motion without a number": ("motion", own("frame.exr"), exr("motion", "forward.v", np.nan, "sky"), {"spot": "sky"}),
    # formats
    "depth.png, two steps": (
        *("depth.png", own("depth.png")),
        picture(own("depth.png"), lambda step: step + 2, "ground"),
        {"spot": "ground"},
    ),
    "depth.json's unit": (
        "depth.png",
        own("depth.png"),
        content(own("depth.json"), lambda c: c.update(unit_m=0.02)),
        {},
    ),
    "a point's plant": (
        *("points.ply", own("points.ply")),
        points(lambda p: p["plant_id"].__setitem__(-1, 88)),
        {"plant_id": 88},
    ),
    "a point's place": ("points.ply", own("points.ply"), points(lambda p: p["z"].__setitem__(0, 9.0)), {}),
    "points.ply cut short": ("points.ply", own("points.ply"), cut(own("points.ply"), 0.99), {}),
    "points.laz cut short": ("points.laz", own("points.laz"), cut(own("points.laz")), {}),
    "COCO's bbox": ("coco", "coco.json", annotation("bbox", [1.0, 2.0, 3.0, 4.0]), {"plant_id": BIRCH, "image": FRAME}),
    "COCO's area": (
        "coco",
        "coco.json",
        annotation("area", lambda area: area + 1),
        {"plant_id": BIRCH, "image": FRAME},
    ),
    "COCO's mask, a pixel": (
        *("coco", "coco.json", turned_mask("segmentation", "birch")),
        {"spot": "birch", "plant_id": BIRCH, "image": FRAME},
    ),
    "COCO's run lengths": (
        *("coco", "coco.json"),
        annotation("segmentation", lambda code: {**code, "counts": code["counts"][:-3]}),
        {"plant_id": BIRCH},
    ),
    "COCO's category": ("coco", "coco.json", annotation("category_id", 1), {"plant_id": BIRCH, "got": "fireweed"}),
    "COCO's plant_id": ("coco", "coco.json", annotation("plant_id", 5), {"plant_id": 5, "image": FRAME}),
    "COCO's stem": ("coco stems", "coco.json", turned_mask("stem_segmentation", "birch"), {"plant_id": BIRCH}),
    "COCO's amodal mask without a visible pixel": (
        *("coco amodal", "coco.json"),
        all_of(turned_mask("amodal_segmentation", "birch"), annotation("amodal_area", lambda area: area - 1)),
        {"spot": "birch", "plant_id": BIRCH},
    ),
    "COCO's amodal box": (
        "coco amodal",
        "coco.json",
        annotation("amodal_bbox", [0.0, 0.0, 96.0, 54.0]),
        {"plant_id": BIRCH},
    ),
    "COCO's keypoints": (
        *("coco keypoints", "coco.json"),
        annotation("keypoints", lambda k: [k[0] + 1, *k[1:]]),
        {"plant_id": BIRCH},
    ),
    "COCO's height": ("coco measures", "coco.json", annotation("height_m", 4.0), {"plant_id": BIRCH, "got": "4"}),
    "the frame's share of COCO": (
        *("coco shard", "coco.json"),
        content(own("annotations.json"), lambda c: c["annotations"][0].update(height_m=4.0)),
        {"plant_id": BIRCH},
    ),
    "COCO's licence": ("coco files", "coco.json", content("coco.json", lambda c: c["images"][0].update(license=9)), {}),
    "COCO without a frame": (
        "coco files",
        "coco.json",
        content("coco.json", lambda c: c["images"].pop()),
        {"image": NEXT},
    ),
    "panoptic, a pixel": (
        *("panoptic", f"panoptic/{FRAME}.png"),
        picture(f"panoptic/{FRAME}.png", (HIDDEN, 0, 0), "birch"),
        {"spot": "birch"},
    ),
    "panoptic's area": (
        *("panoptic", "panoptic.json"),
        content("panoptic.json", lambda c: c["annotations"][0]["segments_info"][0].update(area=1)),
        {"plant_id": BIRCH},
    ),
    "a segment of the frame's own picture": (
        *("panoptic.png", own("panoptic.png")),
        picture(own("panoptic.png"), (HIDDEN, 0, 0), "birch"),
        {"spot": "birch"},
    ),
    "YOLO's box by 1e-5": (
        *("yolo boxes", f"yolo/boxes/labels/{FRAME}.txt"),
        lines(
            f"yolo/boxes/labels/{FRAME}.txt", lambda rows: rows.__setitem__(0, numbers(rows[0], 3, lambda w: w + 1e-5))
        ),
        {"plant_id": BIRCH, "image": FRAME},
    ),
    "YOLO's line missing": (
        *("yolo boxes", f"yolo/boxes/labels/{FRAME}.txt"),
        lines(f"yolo/boxes/labels/{FRAME}.txt", lambda rows: rows.pop()),
        {"image": FRAME},
    ),
    "YOLO's outline": (
        *("yolo outlines", f"yolo/segmentation/labels/{FRAME}.txt"),
        lines(f"yolo/segmentation/labels/{FRAME}.txt", lambda rows: rows.__setitem__(0, half_of_the_outline(rows[0]))),
        {"plant_id": BIRCH},
    ),
    "YOLO's names": ("yolo files", "yolo/boxes/data.yaml", text("yolo/boxes/data.yaml", "names: {0: a, 1: b}\n"), {}),
    "nerfstudio's pose": (
        *("transforms", "transforms.json"),
        content("transforms.json", lambda c: c["frames"][0]["transform_matrix"][0].__setitem__(3, 9.0)),
        {"image": FRAME},
    ),
    "nerfstudio's focal length": (
        *("transforms", "transforms.json"),
        content("transforms.json", lambda c: c["frames"][0].update(fl_x=10.0)),
        {"image": FRAME},
    ),
    "BOP's fraction": (
        *("bop", f"{SCENE}/scene_gt_info.json"),
        content(f"{SCENE}/scene_gt_info.json", lambda c: c["0"][0].update(visib_fract=0.5)),
        {"plant_id": BIRCH},
    ),
    "BOP's mask": (
        *("bop", f"{SCENE}/mask_visib/000000_000000.png"),
        picture(f"{SCENE}/mask_visib/000000_000000.png", 0, "birch"),
        {"spot": "birch", "plant_id": BIRCH},
    ),
    "BOP's mask missing": ("bop", f"{SCENE}/mask/000001_000000.png", gone(f"{SCENE}/mask/000001_000000.png"), {}),
}
