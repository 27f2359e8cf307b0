"""The community models and their environments, by the name that a recipe uses."""

from __future__ import annotations

from forestgen.core.registry import Registry

COMMUNITY_MODELS = Registry(
    "community model",
    {
        "deformation_kernel": (
            "forestgen.community.models.deformation_kernel:MODEL",
            "plants drawn one by one from a density that each of them deforms (Lane 2002, chapter 5)",
        ),
        "forest_footprints": (
            "forestgen.community.models.forest_footprints:MODEL",
            "saplings whose vigour decides who dominates, and whose health tells (Randleff-Rasmussen 2004)",
        ),
        "multiset_lsystem": (
            "forestgen.community.models.multiset_lsystem:MODEL",
            "self-thinning, succession, propagation, or a program of yours (Lane 2002, multiset L-systems)",
        ),
        "placed": (
            "forestgen.community.models.placed:MODEL",
            "plants at given places: an inventory or a figure; nothing grows but older",
        ),
    },
)

ENVIRONMENTS = Registry(
    "environment",
    {
        "domination": (
            "forestgen.community.environments.domination:ENVIRONMENT",
            "of two circles that intersect, the smaller gets nothing (Deussen et al. 1998, Lane 2002)",
        ),
        "firbank_watkinson": (
            "forestgen.community.environments.firbank_watkinson:ENVIRONMENT",
            "zones of influence: shared ground is divided by height (Firbank and Watkinson 1985)",
        ),
        "leps_kindlmann": (
            "forestgen.community.environments.leps_kindlmann:ENVIRONMENT",
            "areas of overlap, weighted by the ratio of heights (Lepš and Kindlmann 1987)",
        ),
        "aikman_watkinson": (
            "forestgen.community.environments.aikman_watkinson:ENVIRONMENT",
            "the mean size against the plot: no neighbours, no places (Aikman and Watkinson 1980)",
        ),
    },
)
