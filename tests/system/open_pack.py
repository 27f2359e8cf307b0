"""Open a pack with Hugging Face's library, in a process of its own: to import it takes seconds.

Writes JSON: what each split holds, pixels as digests, the types of the columns by several ways, and what the loader of
examples/train_segmentation.py makes of it.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from pathlib import Path

import datasets
import numpy as np
import yaml

PICTURES = ("image", "semantic", "instance", "depth")


def digest(picture) -> list:
    pixels = np.asarray(picture)
    return [str(pixels.dtype), list(pixels.shape), hashlib.sha256(pixels.tobytes()).hexdigest()]


def rows(split) -> dict:
    found = {}
    for row in split:
        found[row["frame"]] = {
            key: digest(value) if key in PICTURES else value.hex() if isinstance(value, bytes) else value
            for key, value in row.items()
        }
        assert len(found) <= len(split)
    return found


def loader_of(script: Path) -> dict:
    """The functions `load` and `arrays` of the example: the rest needs libraries that are not installed here."""
    tree = ast.parse(script.read_text(encoding="utf-8"))
    wanted = [
        one for one in tree.body if isinstance(one, ast.FunctionDef) and one.name in ("load", "arrays", "palette")
    ]
    names = {"datasets": datasets, "np": np, "json": json, "Path": Path}
    exec(compile(ast.Module(wanted, []), str(script), "exec"), names)
    return names


def main(pack: str, script: str) -> None:
    loaded = datasets.load_dataset(pack)
    features = next(iter(loaded.values())).features
    card = yaml.safe_load((Path(pack) / "README.md").read_text(encoding="utf-8").split("---\n")[1])
    example = loader_of(Path(script))
    splits, names = example["load"](Path(pack))
    images, truth = example["arrays"](splits["train"])
    answer = {
        "splits": {name: rows(split) for name, split in loaded.items()},
        "order": {name: list(split["frame"]) for name, split in loaded.items()},
        "streamed": [row["frame"] for row in datasets.load_dataset(pack, split="train", streaming=True)],
        "features": features._to_yaml_list(),
        "card_features": card["dataset_info"]["features"],
        "builder_agrees": datasets.load_dataset_builder(pack).info.features == features,
        "example": {
            "classes": names,
            "images": [str(images.dtype), list(images.shape), float(images.min()), float(images.max())],
            "truth": hashlib.sha256(np.ascontiguousarray(truth, np.int32).tobytes()).hexdigest(),
            "palette": example["palette"](splits["train"], len(names)).tolist(),
        },
    }
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main(*sys.argv[1:])
