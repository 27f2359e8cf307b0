"""The known name that is meant by an unknown one: by its synonyms, then by its spelling."""

from __future__ import annotations

import difflib
from collections.abc import Collection

#: Name -> its synonyms. A name is suggested only where it may stand.
_SYNONYMS = {
    # keys of a disturbance
    "burn": "fire burning wildfire", "plant": "planting sow sowing", "at_yr": "year years time when",
    "fell": "cut cutting harvest harvesting log logging felling clearcut thin thinning remove",
    # species that come with forestgen: those of the same genus, of the same use, or in another language
    "acacia": "vachellia umbrella_thorn thorn", "baobab": "adansonia", "beech": "fagus", "birch": "betula",
    "bracken": "fern pteridium", "bramble": "blackberry rubus", "cecropia": "trumpet_tree", "cholla": "cactus",
    "cotton_grass": "eriophorum sedge", "cypress": "cupressus", "eucalyptus": "eucalypt gum mountain_ash",
    "fan_palm": "licuala", "fireweed": "rosebay willowherb", "grass": "tussock deschampsia", "hemlock": "tsuga",
    "juniper": "juniperus", "kapok": "ceiba", "larch": "larix tamarack",
    "lily": "lilium", "maple": "acer sycamore", "meranti": "shorea dipterocarp", "oak": "quercus",
    "palm": "coconut cocos", "pine": "pinus", "poplar": "aspen cottonwood populus", "redgrass": "themeda",
    "sequoia": "redwood sequoiadendron", "shrub": "hazel corylus bush", "snag": "dead_tree deadwood",
    "spruce": "fir abies picea",  # a fir is no spruce, but nothing that comes with forestgen looks more like one
    "sweetgum": "liquidambar", "tree_fern": "dicksonia", "willow": "salix sallow",
}  # fmt: skip
_WITHIN = {"burn": "disturbances", "fell": "disturbances"}  # where a key lies that may not stand here itself
SYNONYMS = {word: name for name, words in _SYNONYMS.items() for word in words.split()}


def nearest(name: str, names: Collection[str], cutoff: float = 0.6) -> str | None:
    """Which of `names` somebody may have meant by `name`; None: none is near.

    Parameters
    ----------
    cutoff : how alike spellings must be, 0 to 1 (`difflib.SequenceMatcher.ratio`).
    """
    meant = SYNONYMS.get(name.strip().lower().replace(" ", "_").replace("-", "_"))
    for one in (meant, _WITHIN.get(meant or name)):
        if one in names:
            return one
    return next(iter(difflib.get_close_matches(name, names, n=1, cutoff=cutoff)), None)


def did_you_mean(name: str, names: Collection[str], cutoff: float = 0.6) -> str | None:
    """The same as a hint of an error."""
    near = nearest(name, names, cutoff)
    return None if near is None else f"did you mean {near!r}?"
