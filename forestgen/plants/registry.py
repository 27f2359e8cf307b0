"""Plant generators by name."""

from __future__ import annotations

from forestgen.core.registry import Registry

GENERATORS = Registry(
    "plant generator",
    {
        "silhouette": (
            "forestgen.plants.generators.silhouette:GENERATOR",
            "Lane's L-system 6.1: branches that fill a silhouette, short ones the tops of longer ones",
        ),
        "deadwood": (
            "forestgen.plants.generators.deadwood:GENERATOR",
            "snags, stumps and logs: broken or sawn stems, stubs of branches, roots",
        ),
        "strands": (
            "forestgen.plants.generators.strands:GENERATOR",
            "bundles of strands that divide until each holds one (Zamuda et al.)",
        ),
        "turtle": (
            "forestgen.plants.generators.turtle:GENERATOR",
            "any L-system program, grown to the derivation step that the plant's height asks for",
        ),
        "auxin_root": (
            "forestgen.plants.generators.auxin_root:GENERATOR",
            "a bent axis: auxin transport, redistribution by gravity, growth of a root's or a shoot's sides",
        ),
        "branch_modules": (
            "forestgen.plants.generators.branch_modules:GENERATOR",
            "twigs and leaves on the branches that the community model branch_modules grew (Makowski 2023)",
        ),
    },
    contract="forestgen.plants.parameters:Generator",
)


def clothes_modules(generator: str) -> bool:
    """Whether a generator grows twigs and leaves on branches that a community grew: see `ClothesModules`."""
    return generator in GENERATORS and hasattr(GENERATORS.load(generator), "clothe")
