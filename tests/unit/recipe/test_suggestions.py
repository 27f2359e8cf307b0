"""Names that people use are understood before spellings are compared."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from forestgen.community.branch_modules.parameters import Change
from forestgen.community.disturbance import Disturbance
from forestgen.core.errors import AssetError
from forestgen.recipe.assets import find_asset, list_assets
from forestgen.recipe.messages import Explainer
from forestgen.recipe.sources import SourceMap
from forestgen.recipe.suggestions import _SYNONYMS, SYNONYMS, did_you_mean, nearest
from support.error_messages import raises_error


def _told(model: type[Disturbance | Change], key: str) -> str:
    data = {"at_yr": 5, key: {}}
    with pytest.raises(ValidationError) as caught:
        model.model_validate(data)
    return str(Explainer(model, data, SourceMap()).error(caught.value))


@pytest.mark.parametrize(
    ("word", "key"),
    [("fire", "burn"), ("harvest", "fell"), ("cut", "fell"), ("log", "fell"), ("planting", "plant"), ("brun", "burn")],
)
def test_what_happens_to_a_stand_goes_by_many_names(word: str, key: str) -> None:
    assert f"did you mean '{key}'?" in _told(Disturbance, word)


@pytest.mark.parametrize(("word", "key"), [("fire", "burn"), ("burn", "burn"), ("cut", "fell")])
def test_a_disturbance_among_the_changes_is_sent_to_its_place(word: str, key: str) -> None:
    message = _told(Change, word)
    assert f"unknown key {word!r}" in message
    assert f"disturbances: [{{at_yr: ..., {key}: ...}}]" in message


@pytest.mark.parametrize("word", ["aspen", "fir", "Betula"])
def test_species_go_by_many_names(word: str) -> None:
    with raises_error(AssetError):
        find_asset("species", word)


def test_a_name_is_suggested_only_where_it_may_stand() -> None:
    assert nearest("fire", ["disturbances", "steps"]) == "disturbances"
    assert nearest("fire", ["steps"]) is None
    assert nearest("aspen", ["oak", "poplar"]) == "poplar"
    assert nearest("aspen", ["oak", "aspens"]) == "aspens"
    assert did_you_mean("xyzzy", ["oak"]) is None


def test_every_species_with_other_names_is_there_and_no_other_name_is_one() -> None:
    shipped = set(list_assets("species"))
    assert set(_SYNONYMS) - {"burn", "fell", "plant", "at_yr"} <= shipped
    assert not set(SYNONYMS) & shipped - {"log"}  # which is a species, and what foresters do
    assert len(SYNONYMS) == sum(len(words.split()) for words in _SYNONYMS.values())
