"""Community models and competition models, by the name that a recipe uses."""

from __future__ import annotations

from collections.abc import Mapping

from forestgen.core.registry import Registry


def _entries(folder: str, descriptions: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Parts whose modules have their ids as names: id -> (dotted path, description)."""
    return {name: (f"forestgen.community.{folder}.{name}:MODEL", text) for name, text in descriptions.items()}


_MODELS = {
    "branch_modules": "plants that grow, compete and die by their branches (Makowski et al. 2019, Synthetic "
    "Silviculture)",
    "deformation_kernel": "plants drawn one by one from a density that each of them deforms (Lane 2002, chapter 5)",
    "ecoclimate": "branch modules that depend on soil water and shade, and change both (Makowski 2023, chapter 4)",
    "forest_footprints": "saplings: vigour determines domination, health determines death (Randleff-Rasmussen 2004)",
    "halftone": "error diffusion (halftoning) of a density into points (Floyd and Steinberg 1975)",
    "height_field": "trees on a jittered grid; the ground determines their species (Reeves and Blau 1985)",
    "inventory": "trees of a list: positions or plots, species, diameters, heights, crowns; they only age",
    "jittered_grid": "one plant per cell of a lattice, moved at random inside its cell (Neyret 1996)",
    "kernel_growth": "establishment and competition of plants by the same deformation kernels (Lane 2002, chapter 7)",
    "multiset_lsystem": "self-thinning, succession, propagation, or your own program (Lane 2002, multiset L-systems)",
    "placed": "plants at given positions, as of a figure; they only age",
    "poisson_disc": "random positions with a minimum distance (Bridson 2007)",
    "stand": "trees by what foresters know: species, stems, basal area, heights, storeys, gaps, cover, leaf area",
    "strauss": "plants of a species that repel each other with given strength (Strauss 1975)",
    "thomas": "clusters around unobserved parent points (Thomas 1949)",
    "uniform": "independent random positions",
}
COMMUNITY_MODELS = Registry(
    "community model", _entries("models", _MODELS), contract="forestgen.community.model:CommunityModel"
)

_COMPETITION = {
    "domination": "of two circles that intersect, the smaller gets nothing (Deussen et al. 1998, Lane 2002)",
    "firbank_watkinson": "zones of influence: shared ground is divided by height (Firbank and Watkinson 1985)",
    "leps_kindlmann": "areas of overlap, weighted by the ratio of heights (Lepš and Kindlmann 1987)",
    "crown_light": "crowns overlap; each gets the light that the leaves above it leave (Monsi and Saeki 1953)",
    "aikman_watkinson": "size relative to the mean and plot crowding; positions do not matter (Aikman and Watkinson "
    "1980)",
}
COMPETITION_MODELS = Registry(
    "competition model",
    _entries("competition", _COMPETITION),
    contract="forestgen.community.competition.contract:CompetitionModel",
)
DEFAULT_COMPETITION_MODEL = "domination"
