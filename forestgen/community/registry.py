"""The community models and their environments, by the name that a recipe uses."""

from __future__ import annotations

from forestgen.core.registry import Registry

COMMUNITY_MODELS = Registry(
    "community model",
    {
        "branch_modules": (
            "forestgen.community.models.branch_modules:MODEL",
            "plants that grow, compete and die by their branches (Makowski et al. 2019, Synthetic Silviculture)",
        ),
        "deformation_kernel": (
            "forestgen.community.models.deformation_kernel:MODEL",
            "plants drawn one by one from a density that each of them deforms (Lane 2002, chapter 5)",
        ),
        "ecoclimate": (
            "forestgen.community.models.ecoclimate:MODEL",
            "branch modules that live by soil water and shade, and shape them (Makowski 2023, chapter 4)",
        ),
        "forest_footprints": (
            "forestgen.community.models.forest_footprints:MODEL",
            "saplings whose vigour decides who dominates, and whose health tells (Randleff-Rasmussen 2004)",
        ),
        "halftone": (
            "forestgen.community.models.halftone:MODEL",
            "points that follow a density as a printer's dots follow grey (Floyd and Steinberg 1975)",
        ),
        "height_field": (
            "forestgen.community.models.height_field:MODEL",
            "trees on a jittered grid, of the species that the ground suits (Reeves and Blau 1985)",
        ),
        "jittered_grid": (
            "forestgen.community.models.jittered_grid:MODEL",
            "a plant a cell of a lattice, moved inside its cell (Neyret 1996)",
        ),
        "kernel_growth": (
            "forestgen.community.models.kernel_growth:MODEL",
            "seedlings where the plants' kernels let them, and competition by the same kernels (Lane 2002, chapter 7)",
        ),
        "multiset_lsystem": (
            "forestgen.community.models.multiset_lsystem:MODEL",
            "self-thinning, succession, propagation, or a program of yours (Lane 2002, multiset L-systems)",
        ),
        "placed": (
            "forestgen.community.models.placed:MODEL",
            "plants at given places: an inventory or a figure; nothing grows but older",
        ),
        "poisson_disc": (
            "forestgen.community.models.poisson_disc:MODEL",
            "random places no two of which are near one another (Bridson 2007)",
        ),
        "strauss": (
            "forestgen.community.models.strauss:MODEL",
            "plants that dislike, to a degree, to stand near their like (Strauss 1975)",
        ),
        "thomas": (
            "forestgen.community.models.thomas:MODEL",
            "clusters around parents that nobody sees (Thomas 1949)",
        ),
        "uniform": (
            "forestgen.community.models.uniform:MODEL",
            "independent random places: no pattern at all",
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
