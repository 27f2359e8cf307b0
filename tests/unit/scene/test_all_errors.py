"""All that is wrong with a recipe is told at once, in the order of its file."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from forestgen.api.recipes import load_checked
from forestgen.core.errors import AssetError, ErrorList, ForestgenError, RecipeError, RecipeErrors
from forestgen.scene.plan import check_plan

RECIPE = """\
forestgen: 1
seed: 7
site: {size_m: [60, 50]}
species:
  spruce: {height_m: 20}
  birch: {from: birch}
  pine: {plant: {density: 0.5}}
community: {model: multiset_lsystem, program: succession, steps: 3}
sky: {turbidity: {uniform: [2, 4]}, sun: {elevation_deg: 40, azimuth_deg: 140}}
wind: {speed_m_per_s: 3}
cameras:
  - {position_m: [30, 2, 1.7], look_at_m: [30, 40, 3]}
  - {position_m: [30, 2, 3], look_at_m: [30, 40, 3]}
"""
SOUND = RECIPE.replace("{plant: {density: 0.5}}", "")
WRONG = {  # line -> what is written instead, and the key that the error names
    2: ("seed: 7", "seed: x", "seed"),
    3: ("[60, 50]", "[60, -1]", "site.size_m.1"),
    5: ("height_m: 20", "height_m: 900", "species.spruce.height_m"),
    6: ("from: birch", "from: brich", "species.birch.from"),
    7: ("  pine: ", "  pine: {plant: {lefs: 3}}", "species.pine.plant.lefs"),
    8: ("steps: 3", "stepz: 3", "community.stepz"),
    9: ("uniform: [2, 4]", "unifrom: [2, 4]", "sky.turbidity"),
    10: ("speed_m_per_s: 3", "speed_m_per_s: -3", "wind.speed_m_per_s"),
    13: ("[30, 2, 3]", "[30, 2, -9]", "cameras.1.position_m"),
}


def errors_of(path: Path) -> tuple[ForestgenError, ...]:
    with pytest.raises((RecipeError, AssetError)) as caught:
        check_plan(load_checked(path))
    return caught.value.errors


def written(folder: Path, *lines: int) -> Path:
    text = SOUND
    for line in lines:
        old, new, _ = WRONG[line]
        assert old in text
        text = text.replace(old, new)
    path = folder / "stand.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("lines", [[line] for line in WRONG])
def test_each_alone(tmp_path: Path, lines: list[int]) -> None:
    path = written(tmp_path, *lines)
    (error,) = errors_of(path)
    assert error.where == f"{path}:{lines[0]}: {WRONG[lines[0]][2]}"


@pytest.mark.parametrize(
    "lines", [[5, 7, 8, 13], [8, 13], [2, 8], [6, 9, 10], [3, 8], [7, 9], [6, 8, 13], [*WRONG][:-1]]
)
def test_none_hides_another(tmp_path: Path, lines: list[int]) -> None:
    """But for a camera below the ground: where that is, a site of unknown extent does not say."""
    path = written(tmp_path, *lines)
    found = errors_of(path)
    assert [error.where for error in found] == [f"{path}:{line}: {WRONG[line][2]}" for line in lines]


def test_what_depends_on_a_wrong_section_is_not_judged(tmp_path: Path) -> None:
    path = written(tmp_path, 5)
    path.write_text(path.read_text() + "labels: {classes: {conifers: [spruce], others: [others]}}\n")
    (error,) = errors_of(path)
    assert "species.spruce.height_m" in (error.where or "")
    path.write_text(
        SOUND.replace("[60, 50]", "[60, -1]").replace(
            "sun: {elevation_deg: 40, azimuth_deg: 140}",
            "sun: {date: 2024-06-21, time: '12:00', utc_offset_h: 2}",
        )
    )
    (error,) = errors_of(path)
    assert "site.size_m" in (error.where or "")


def test_every_unknown_species_of_a_community_is_told(tmp_path: Path) -> None:
    path = written(tmp_path)
    given = "model: deformation_kernel, plants: {sprus: {count: 3}, brich: {count: 2}}, disturbances: [{at_step: 0, "
    given += "plant: {species: pime, count: 3}}]"
    path.write_text(path.read_text().replace("model: multiset_lsystem, program: succession, steps: 3", given))
    found = {(error.where or "").rpartition(".")[2]: error.hint for error in errors_of(path)}
    assert set(found) >= {"sprus", "brich"}
    assert found["sprus"] == "did you mean 'spruce'?"


@pytest.mark.parametrize(
    ("community", "keys"),
    [
        ("model: multiset_lsytem, program: sucession, steps: sixty", {"model", "program", "steps"}),
        ("model: multiset_lsystem, program: sucession, steps: sixty, environmnt: domination",
         {"program", "steps", "environmnt"}),
        ("model: nonesuch, steps: -1, per_ha: 3", {"model", "steps"}),
        ("model: nonesuch", {"model"}),
        ("model: multiset_lsystem, program: sucession, steps: {integers: [20, 400]}", {"program"}),
        ("steps: 3", {"model"}),
    ],
)  # fmt: skip
@pytest.mark.parametrize("other", [(), (10,)])
def test_no_error_of_a_community_hides_another(
    community: str, keys: set[str], other: tuple[int, ...], tmp_path: Path
) -> None:
    path = written(tmp_path, *other)
    path.write_text(path.read_text().replace("model: multiset_lsystem, program: succession, steps: 3", community))
    with pytest.raises((RecipeError, AssetError)) as caught:
        load_checked(path)
    expected = {f"{path}:8: community.{key}" for key in keys} | {f"{path}:{n}: {WRONG[n][2]}" for n in other}
    assert {error.where for error in caught.value.errors} == expected


def test_bad_overrides_are_told_with_the_rest(tmp_path: Path) -> None:
    path = written(tmp_path, 8)
    with pytest.raises(RecipeErrors) as caught:
        load_checked(path, ["seed.x=3", "site.size_m=[1, 0]"])
    assert [error.where for error in caught.value.errors] == [
        f"{path}:8: community.stepz",
        "`set='seed.x=3'`",
        "`set='site.size_m=[1, 0]'`: site.size_m.1",
    ]


def test_the_message_is_that_of_each_and_their_number(tmp_path: Path) -> None:
    with pytest.raises(RecipeErrors) as caught:
        load_checked(written(tmp_path, 2, 10))
    one, two = caught.value.errors
    assert str(caught.value) == f"{one}\n\n{two}\n\n2 errors"
    assert caught.value.text("error: ") == f"error: {one}\n\nerror: {two}\n\n2 errors"
    assert caught.value.exit_code == 2
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)


def test_an_error_list_says_one_thing_of_a_place() -> None:
    errors = ErrorList("a.yaml")
    errors.add(RecipeError("late", where="a.yaml:9: x"))
    errors.add(RecipeErrors([RecipeError("asset", where="b.yaml:1: y"), RecipeError("early", where="a.yaml:2: z")]))
    errors.add(RecipeError("again", where="a.yaml:9: x"))
    with pytest.raises(RecipeErrors) as caught:
        errors.raise_all()
    assert [error.problem for error in caught.value.errors] == ["early", "late", "asset"]
