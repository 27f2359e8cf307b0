"""Semantic classes: the rules, and every way to get them wrong."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.dataset.check.files import categories
from forestgen.recipe.classes import PLANT_PARTS, ClassMap, wrong_classes
from forestgen.recipe.load import load_recipe
from support.error_messages import raises_error

SPECIES = ("poplar", "spruce", "fir")
NOT_PLANTS = (Part.NOTHING, Part.GROUND, Part.LITTER, Part.ROCK, Part.WATER)


def class_name(classes, species, part):
    """By its name; a species of None is no plant."""
    row = len(classes.species_names) if species is None else classes.species_names.index(species)
    return classes.names[classes.class_of[row, part]]


def test_without_classes_each_species_is_one():
    classes = ClassMap(SPECIES)
    assert classes.names == ("nothing", "ground", *SPECIES)
    for part in Part:
        for species in SPECIES:
            assert part == Part.NOTHING or class_name(classes, species, part) == species
        assert class_name(classes, None, part) == ("nothing" if part == Part.NOTHING else "ground")


def test_a_part_goes_before_a_species_and_others_are_the_rest():
    classes = ClassMap(
        SPECIES,
        {
            "broadleaved": ("others",),
            "stone": ("rock",),
            "conifer": ("spruce", "fir", "fruit"),
            "wood": ("trunk", "branch"),
        },
    )
    assert classes.names == ("nothing", "ground", "broadleaved", "stone", "conifer", "wood")
    for species in SPECIES:
        own = "broadleaved" if species == "poplar" else "conifer"
        assert class_name(classes, species, Part.LEAF) == own
        assert class_name(classes, species, Part.DEAD_WOOD) == own
        assert class_name(classes, species, Part.TRUNK) == class_name(classes, species, Part.BRANCH) == "wood"
        assert class_name(classes, species, Part.FRUIT) == "conifer"
    assert [class_name(classes, None, part) for part in NOT_PLANTS] == [
        "nothing",
        "ground",
        "ground",
        "stone",
        "ground",
    ]


def test_parts_alone_do_when_they_are_all():
    rules = {"wood": ("trunk", "branch", "dead_wood"), "green": ("leaf", "flower", "fruit"), "spare": ()}
    classes = ClassMap(SPECIES, rules)
    assert class_name(classes, "fir", Part.FLOWER) == "green"
    assert classes.names[-1] == "spare"


def test_a_species_called_others_is_a_species():
    classes = ClassMap(("others", "fir"), {"a": ("others",), "b": ("fir",)})
    assert [class_name(classes, name, Part.LEAF) for name in ("others", "fir")] == ["a", "b"]
    assert "fir" in str(wrong_classes({"a": ("others",)}, ("others", "fir")).context)


@pytest.mark.parametrize(
    ("classes", "names", "own"),
    [
        (None, SPECIES, SPECIES),
        # others come in the place of their class; a class of parts alone is no category
        (
            {"rest": ("others",), "wood": ("trunk",), "conifer": ("fir", "fruit", "spruce")},
            ("rest", "conifer"),
            ("rest", "conifer", "conifer"),
        ),
        # parts are all in classes, so species may be left out
        ({"b": ("spruce",), "all": PLANT_PARTS}, ("b", "poplar", "fir"), ("poplar", "b", "fir")),
        ({"all": PLANT_PARTS}, SPECIES, SPECIES),
        ({"spare": ("others",), "a": SPECIES}, ("spare", "a"), ("a", "a", "a")),
    ],
)
def test_categories_of_plants(classes, names, own):
    found, index = ClassMap(SPECIES, classes).instance_categories
    assert found == names
    assert tuple(found[i] for i in index) == own


def test_the_checker_finds_the_same_categories_by_its_own_rules():
    rng = np.random.default_rng(2)
    species = ("poplar", "spruce", "fir", "oak")
    tried = 0
    for _ in range(400):
        members = rng.permutation([*species, *PLANT_PARTS, "others"])[: rng.integers(5, 12)].tolist()
        classes = {name: [] for name in ("a", "b", "poplar")}
        for member in members:
            classes[str(rng.choice(list(classes)))].append(member)
        if wrong_classes(classes, species) is not None:
            continue
        names, index = ClassMap(species, classes).instance_categories
        tried += 1
        recipe = {"species": list(species), "labels": {"classes": classes}}
        assert categories(recipe) == (list(names), {one: names[i] for one, i in zip(species, index, strict=True)})
    assert tried > 50


@pytest.mark.parametrize(
    ("classes", "where", "said"),
    [
        ({"a": ("others", "sprouce")}, "labels.classes.a.1", "did you mean 'spruce'"),
        ({"a": ("others", "Leaf")}, "labels.classes.a.1", "did you mean 'leaf'"),
        ({"a": ("spruce", "poplar")}, "labels.classes", "fir"),
        ({"a": ("leaf", "trunk", "branch")}, "labels.classes", "flower, fruit, dead_wood"),
        ({"a": ("others",), "b": ("fir",), "c": ("fir",)}, "labels.classes.c.0", "also in b"),
        ({"a": ("others", "others")}, "labels.classes.a.1", "also in a"),
        ({"fir": ("spruce",), "all": PLANT_PARTS}, "labels.classes.fir", "name of a species that it lacks"),
        ({"Ground": ("others",)}, "labels.classes.Ground", "there already"),
        ({"a": ("nothing", "others")}, "labels.classes.a.0", "neither"),
    ],
)
def test_mistakes_name_their_place(classes, where, said):
    context = wrong_classes(classes, SPECIES).context
    assert ".".join(map(str, context.pop("at"))) == where
    assert said in " ".join(map(str, context.values()))


def test_a_name_of_both_kinds_is_ambiguous():
    assert "ambiguous" in wrong_classes({"a": ("leaf",)}, ("leaf",)).context["problem"]


def test_the_recipe_says_where(tmp_path):
    (tmp_path / "r.yaml").write_text(
        "forestgen: 1\nspecies: {poplar: , spruce: }\ncommunity: {model: multiset_lsystem, program: succession}\n"
        "labels:\n  classes:\n    tree: [poplar]\n    conifer:\n    - sprouce\n"
    )
    with raises_error(RecipeError, place="labels.classes.conifer.0") as caught:
        load_recipe(tmp_path / "r.yaml").check()
    assert "r.yaml:8" in str(caught.value.where)


def test_the_last_class_fits_and_the_next_fails_loudly():
    most = tuple(f"s{i}" for i in range(254))
    assert ClassMap(most).class_of.max() == 255
    with raises_error(RecipeError, place="species"):
        ClassMap((*most, "one-more"))
    assert len(ClassMap((*most, "one-more"), {"tree": ("others",)}).names) == 3


def test_species_follow_the_recipes_order():
    classes = ClassMap(SPECIES)
    assert classes.species_index(("fir", "poplar")).tolist() == [2, 0]
    with pytest.raises(ValueError, match="oak"):
        classes.species_index(("oak",))


def test_the_mask_of_an_image_uses_them():
    from forestgen.labels.masks import pixel_labels

    samples = np.array([[[7, 7, 7, 0]], [[0, 0, 0, 7]]], np.uint32)
    part = np.array(
        [[[Part.TRUNK, Part.LEAF, Part.LEAF, Part.GROUND]], [[Part.ROCK, Part.ROCK, Part.GROUND, Part.LEAF]]]
    )
    classes = ClassMap(("fir",), {"fir": ("others",), "leaf": ("leaf",), "rock": ("rock",)})
    labels = pixel_labels(samples, part.astype(np.uint8), np.array([7], np.uint32), np.array([0]), classes)
    assert [classes.names[number] for number in labels.semantic[:, 0]] == ["leaf", "rock"]
