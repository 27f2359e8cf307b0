from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError
from forestgen.dataset.settings import check_splits
from forestgen.recipe.dataset import place_in_splits, split_of, used_splits
from forestgen.recipe.load import load_recipe
from support.error_messages import raises_error

Write = Callable[..., Path]
SPLITS = [
    {"train": 8.0, "val": 1.0, "test": 1.0},
    {"train": 1.0},
    {"a": 0.1, "b": 0.2, "c": 0.7, "rare": 1e-3},
    {"one": 1.0, "two": 1.0, "three": 1.0},
]


@pytest.mark.parametrize("splits", SPLITS, ids=str)
@pytest.mark.parametrize("first", [0, 1, 1000, 12_345])
def test_every_stretch_has_the_shares(splits: dict[str, float], first: int) -> None:
    total = sum(splits.values())
    found: Counter[str] = Counter()
    for n in range(1, 1500):
        found[split_of(splits, first + n - 1)] += 1
        for name, share in splits.items():
            assert abs(found[name] - n * share / total) <= 1 + math.log2(n), (name, n)


@pytest.mark.parametrize("splits", SPLITS, ids=str)
def test_ranks_count_the_images_of_a_split(splits: dict[str, float]) -> None:
    seen: Counter[str] = Counter()
    for image in range(1500):
        name, rank = place_in_splits(splits, image)
        assert name == split_of(splits, image)
        assert rank == seen[name]
        seen[name] += 1


def test_ranks_far_out_go_up_by_one() -> None:
    splits = SPLITS[0]
    near = [place_in_splits(splits, 10**12 - 500 + n) for n in range(500)]
    for name in splits:
        ranks = [rank for one, rank in near if one == name]
        assert ranks == list(range(ranks[0], ranks[0] + len(ranks)))
        assert abs(ranks[-1] - 10**12 * splits[name] / 10) <= 50


def test_shares_count_by_their_ratio() -> None:
    for image in range(500):
        assert split_of({"a": 3, "b": 1}, image) == split_of({"a": 0.75, "b": 0.25}, image)


def test_a_batch_that_grows_moves_no_image(write: Write) -> None:
    # An image's split depends on its number alone, so that of a later start is that of the same number.
    early, late = load_recipe(write()), load_recipe(write(), ["first_image=20", "images=7"])
    assert [early.draw(20 + n).split for n in range(30)] == [late.draw(n).split for n in range(30)]


def test_seeds_of_images_differ_among_splits(write: Write) -> None:
    loaded = load_recipe(write())
    seeds: dict[str, set[int]] = {}
    for index in range(60):
        drawn = loaded.draw(index)
        seeds.setdefault(drawn.split, set()).add(drawn.image_seed)
    assert sorted(seeds) == ["test", "train", "val"]
    assert len(set.union(*seeds.values())) == sum(map(len, seeds.values())) == 60


def test_a_stand_for_each_split(write: Write) -> None:
    loaded = load_recipe(write(), ["same_stand=by_split"])
    drawn = [loaded.draw(index) for index in range(30)]
    seeds = {split: {one.image_seed for one in drawn if one.split == split} for split in ("train", "val", "test")}
    assert all(len(of_split) == 1 for of_split in seeds.values())
    assert len(set.union(*seeds.values())) == 3
    assert len({one.recipe.sky.turbidity for one in drawn}) == 30  # what is drawn is still drawn
    check_splits(loaded, ["train", "val", "test"])
    own = load_recipe(write(), ["same_stand=by_split", "seed=8"])
    assert own.draw(0).image_seed not in seeds["train"]


def test_one_stand_may_not_be_in_two_splits(write: Write) -> None:
    check_splits(load_recipe(write()), ["train", "val", "test"])
    check_splits(load_recipe(write(), ["same_stand=true"]), ["train"])  # the others hold no image
    with raises_error(RecipeError, place="same_stand"):
        check_splits(load_recipe(write(), ["same_stand=true"]), ["train", "val", "test"])


@pytest.mark.parametrize("splits", SPLITS)
def test_used_splits_are_those_of_the_images(splits: dict[str, float]) -> None:
    for images in (range(0), range(1), range(3, 5), range(40), range(10**9, 10**9 + 7)):
        assert used_splits(splits, images) == list(dict.fromkeys(split_of(splits, image) for image in images))
    assert set(used_splits(splits, range(10**15))) == set(splits)  # without looking at them all


@pytest.mark.parametrize("value", ["{choice: [true, false]}", "by_image", "1"])
def test_what_same_stand_may_be(write: Write, value: str) -> None:
    with raises_error(RecipeError, place="same_stand"):
        load_recipe(write(), [f"same_stand={value}"])


def test_shares_are_not_drawn(write: Write) -> None:
    with raises_error(RecipeError, place="dataset.splits.train"):
        load_recipe(write(), ["dataset.splits={train: {uniform: [1, 2]}, val: 1}"])
