"""Class balance from the index against counting the masks themselves."""

from __future__ import annotations

import json

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from forestgen.dataset.index import INDEX_NAME
from forestgen.dataset.report.frames import read_frames
from forestgen.dataset.report.sections import RARE, balance
from support.data_sets import SPLITS, write_data_set

COUNTS = st.dictionaries(st.sampled_from("abcde"), st.integers(0, 10**12), max_size=5)


def test_pixels_are_those_of_the_masks(tmp_path):
    write_data_set(tmp_path, 25, run=False)
    frames = read_frames(tmp_path / INDEX_NAME)
    legend = json.loads((tmp_path / "train" / "classes.json").read_text())["semantic"]
    counted = balance(frames.counts("class_pixels"), frames.split, tuple(legend.values()), tuple(SPLITS))
    for j, split in enumerate(SPLITS):
        masks = [np.asarray(Image.open(path)) for path in sorted((tmp_path / split).glob("*/semantic.png"))]
        assert masks
        for number, name in legend.items():
            i = counted.names.index(name)
            assert counted.counts[i, j] == sum(int((mask == int(number)).sum()) for mask in masks)
            assert counted.frames[i, j] == sum(bool((mask == int(number)).any()) for mask in masks)
    assert np.allclose(counted.shares.sum(axis=0), 1.0)


def test_instances_are_those_of_the_masks(tmp_path):
    write_data_set(tmp_path, 12, run=False)
    frames = read_frames(tmp_path / INDEX_NAME)
    counted = balance(frames.counts("category_instances"), frames.split, (), tuple(SPLITS))
    found = dict.fromkeys(counted.names, 0)
    for path in tmp_path.glob("*/*/instance.png"):
        instance = np.asarray(Image.open(path))[..., 0]
        with Image.open(path.with_name("semantic.png")) as mask:
            names, semantic = json.loads(mask.info["classes"]), np.asarray(mask)
        for plant in np.unique(instance[instance > 0]):
            found[names[str(semantic[instance == plant][0])]] += 1
    assert dict(zip(counted.names, counted.counts.sum(axis=1).tolist(), strict=True)) == found


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.none() | COUNTS, st.sampled_from(["train", "val"])), max_size=12))
def test_sums_are_exact_and_warnings_complete(rows):
    counted = balance([one for one, _ in rows], [part for _, part in rows], ("a", "b"), ("train", "val", "test"))
    assert counted.names[:2] == ("a", "b")
    lacking, rare = set(counted.lacking()), set(counted.rare())
    for i, name in enumerate(counted.names):
        for j, split in enumerate(counted.splits):
            total = sum(sum(one.values()) for one, part in rows if one and part == split)
            here = sum(one.get(name, 0) for one, part in rows if one and part == split)
            assert counted.counts[i, j] == here
            assert ((name, split) in lacking) == (here == 0)
            assert ((name, split) in rare) == (0 < here < RARE * total)
