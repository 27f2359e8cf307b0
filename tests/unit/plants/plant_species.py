"""Species as the files give them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ruamel.yaml import YAML

from forestgen.plants.generators.silhouette import Parameters

SPECIES = Path(__file__).parents[3] / "scenes" / "species"
NAMES = ("poplar", "spruce", "fireweed")


def read(name: str) -> tuple[Any, Parameters]:
    data = YAML(typ="safe").load((SPECIES / f"{name}.yaml").read_text(encoding="utf-8"))
    allometry = {key: SimpleNamespace(**law) for key, law in data["allometry"].items()}
    species = SimpleNamespace(allometry=SimpleNamespace(**allometry), materials=data["materials"])
    return species, Parameters.model_validate(data["plant"])
