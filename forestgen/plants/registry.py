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
    },
)
