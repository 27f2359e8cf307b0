"""The community models, by the name that a recipe uses."""

from __future__ import annotations

from forestgen.core.registry import Registry

COMMUNITY_MODELS = Registry(
    "community model",
    {
        "multiset_lsystem": (
            "forestgen.community.models.multiset_lsystem:MODEL",
            "self-thinning and succession of circles that compete for space (Lane 2002, multiset L-systems)",
        ),
    },
)
