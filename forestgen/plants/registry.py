"""Plant generators by name."""

from __future__ import annotations

from forestgen.core.registry import Registry

_ABOUT = {
    "silhouette": "Lane's L-system 6.1: branches that fill a silhouette, short ones the tops of longer ones",
    "deadwood": "snags, stumps and logs: broken or sawn stems, stubs of branches, roots",
    "strands": "bundles of strands that divide until each holds one (Zamuda et al.)",
    "turtle": "any L-system program, grown to the derivation step that the plant's height asks for",
    "auxin_root": "a bent axis: auxin transport, redistribution by gravity, growth of a root's or a shoot's sides",
    "branch_modules": "twigs and leaves on the branches that the community model branch_modules grew (Makowski 2023)",
}
GENERATORS = Registry(
    "plant generator",
    {name: (f"forestgen.plants.generators.{name}:GENERATOR", about) for name, about in _ABOUT.items()},
    contract="forestgen.plants.parameters:Generator",
)


def clothes_modules(generator: str) -> bool:
    """Whether a generator grows twigs and leaves on branches that a community grew: see `ClothesModules`."""
    return generator in GENERATORS and hasattr(GENERATORS.load(generator), "clothe")
