"""forestgen: physically based, exactly labelled images of plant communities.

>>> import forestgen as fg
>>> recipe = fg.load("recipes/quickstart.yaml", set={"sky.turbidity": 5})   # doctest: +SKIP
>>> stand = recipe.simulate()                                               # doctest: +SKIP
>>> for frame in recipe.frames(3):                                          # doctest: +SKIP
...     frame.radiance, frame.instance, frame.plants
>>> recipe.render("outputs/stand")                                          # doctest: +SKIP
>>> fg.Dataset("outputs/stand")[0].preview                                  # doctest: +SKIP

Names are imported when they are first used, so that `import forestgen` takes milliseconds.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from forestgen.api.catalogue import models, register, schema, species
    from forestgen.api.datasets import Dataset, merge, verify
    from forestgen.api.diagnosis import doctor
    from forestgen.api.plants import Plant, plant
    from forestgen.api.points import fit_kernel, stats
    from forestgen.api.programs import derive
    from forestgen.api.recipes import Recipe, load
    from forestgen.api.stands import Stand
    from forestgen.core import __version__
    from forestgen.core.errors import (
        AssetError,
        DatasetError,
        ForestgenError,
        LsystemError,
        OutputError,
        RecipeError,
        RenderError,
        ResourceError,
    )
    from forestgen.dataset.frame import Frame

_ERRORS = (
    "AssetError", "DatasetError", "ForestgenError", "LsystemError", "OutputError", "RecipeError", "RenderError",
    "ResourceError",
)  # fmt: skip
_MODULES = {
    **dict.fromkeys(("load", "Recipe"), "forestgen.api.recipes"),
    "Stand": "forestgen.api.stands",
    "Frame": "forestgen.dataset.frame",
    **dict.fromkeys(("Dataset", "merge", "verify"), "forestgen.api.datasets"),
    **dict.fromkeys(("plant", "Plant"), "forestgen.api.plants"),
    "doctor": "forestgen.api.diagnosis",
    **dict.fromkeys(("models", "register", "schema", "species"), "forestgen.api.catalogue"),
    **dict.fromkeys(("fit_kernel", "stats"), "forestgen.api.points"),
    "derive": "forestgen.api.programs",
    "__version__": "forestgen.core",
    **dict.fromkeys(_ERRORS, "forestgen.core.errors"),
}

__all__ = [
    "AssetError", "Dataset", "DatasetError", "ForestgenError", "Frame", "LsystemError", "OutputError", "Plant",
    "Recipe", "RecipeError", "RenderError", "ResourceError", "Stand", "__version__", "derive", "doctor", "fit_kernel",
    "load", "merge", "models", "plant", "register", "schema", "species", "stats", "verify",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'forestgen' has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
