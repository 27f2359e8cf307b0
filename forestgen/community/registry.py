"""Community models and competition models, by the name that a recipe uses."""

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
            "branch modules that depend on soil water and shade, and change both (Makowski 2023, chapter 4)",
        ),
        "forest_footprints": (
            "forestgen.community.models.forest_footprints:MODEL",
            "saplings: vigour determines domination, health determines death (Randleff-Rasmussen 2004)",
        ),
        "halftone": (
            "forestgen.community.models.halftone:MODEL",
            "error diffusion (halftoning) of a density into points (Floyd and Steinberg 1975)",
        ),
        "height_field": (
            "forestgen.community.models.height_field:MODEL",
            "trees on a jittered grid; the ground determines their species (Reeves and Blau 1985)",
        ),
        "jittered_grid": (
            "forestgen.community.models.jittered_grid:MODEL",
            "one plant per cell of a lattice, moved at random inside its cell (Neyret 1996)",
        ),
        "kernel_growth": (
            "forestgen.community.models.kernel_growth:MODEL",
            "establishment and competition of plants by the same deformation kernels (Lane 2002, chapter 7)",
        ),
        "multiset_lsystem": (
            "forestgen.community.models.multiset_lsystem:MODEL",
            "self-thinning, succession, propagation, or your own program (Lane 2002, multiset L-systems)",
        ),
        "placed": (
            "forestgen.community.models.placed:MODEL",
            "plants at given positions, from an inventory or a figure; they only age",
        ),
        "poisson_disc": (
            "forestgen.community.models.poisson_disc:MODEL",
            "random positions with a minimum distance (Bridson 2007)",
        ),
        "strauss": (
            "forestgen.community.models.strauss:MODEL",
            "plants of a species that repel each other with given strength (Strauss 1975)",
        ),
        "thomas": (
            "forestgen.community.models.thomas:MODEL",
            "clusters around unobserved parent points (Thomas 1949)",
        ),
        "uniform": (
            "forestgen.community.models.uniform:MODEL",
            "independent random positions",
        ),
    },
    contract="forestgen.community.model:CommunityModel",
)

DEFAULT_COMPETITION_MODEL = "domination"
COMPETITION_MODELS = Registry(
    "competition model",
    {
        "domination": (
            "forestgen.community.competition.domination:MODEL",
            "of two circles that intersect, the smaller gets nothing (Deussen et al. 1998, Lane 2002)",
        ),
        "firbank_watkinson": (
            "forestgen.community.competition.firbank_watkinson:MODEL",
            "zones of influence: shared ground is divided by height (Firbank and Watkinson 1985)",
        ),
        "leps_kindlmann": (
            "forestgen.community.competition.leps_kindlmann:MODEL",
            "areas of overlap, weighted by the ratio of heights (Lepš and Kindlmann 1987)",
        ),
        "aikman_watkinson": (
            "forestgen.community.competition.aikman_watkinson:MODEL",
            "size relative to the mean and plot crowding; positions do not matter (Aikman and Watkinson 1980)",
        ),
    },
    contract="forestgen.community.competition.contract:CompetitionModel",
)
