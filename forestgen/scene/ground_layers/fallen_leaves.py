"""Fallen leaves and needles of the stand's own species, dry, brighter and darker with age.

Each species' lie where its crowns are: their share of the ground follows that of the leaf area above within some
metres. Leaves are those of the species file, curled as they dried.

Example
-------
    site: {ground: {kind: litter, layers: [{what: fallen_leaves, cover: 0.8}]}}
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from forestgen.core.parts import Part
from forestgen.geometry.patches import copies, strip
from forestgen.plants.organs.base import OrganForm
from forestgen.recipe.ground import GroundLayer
from forestgen.recipe.phenology import LeafState
from forestgen.recipe.species import Species
from forestgen.scene.ground_layers.layer import (
    GroundLayerKind,
    Layer,
    Request,
    Spread,
    Thing,
    centred,
    scaled,
    shades,
    sheet,
)
from forestgen.scene.surfaces import surface_of

_CURLS_DEG, _FOLDS_DEG = (-35.0, -8.0, 14.0, 45.0), (12.0, 3.0, 18.0, 30.0)
_SHADES = (0.3, 0.45, 0.62, 0.85)  # old leaves are half rotten
_NEEDLE_SHADES = (0.68, 0.95, 1.22, 1.63)  # a floor of them reflects as measured: spectra/ground/litter_needles
_TRAPPED = {"needle": 0.52}  # share of light, by type of leaf: benchmarks/ground_cover.py
_TRAPPED_BY_BLADES = 0.32
_LEAST_SHARE = 0.03  # of the leaf area: rarer species leave nothing that one sees
_IN_ONE = 60  # needles that make one thing


class LeavesKeys(GroundLayer):
    """Fallen leaves and needles."""


class Leaves(GroundLayerKind[LeavesKeys]):
    """Fallen leaves."""

    Parameters = LeavesKeys

    def layers(self, keys: LeavesKeys, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        found = []
        for name, (share, where) in request.leaf_share.items():
            species = request.drawn.species.get(name)  # none: a building
            if species is None:
                continue
            key = next((key for key, one in species.materials.items() if one.leaf_type is not None), None)
            if key is None or share < _LEAST_SHARE:
                continue
            dry = surface_of(
                species.materials[key].model_copy(update={"season": None}), LeafState.of_season("dry"), name
            )
            things = _fallen(request, name, species, key, rng)
            factors = _NEEDLE_SHADES if species.materials[key].leaf_type == "needle" else _SHADES
            if not things or dry.reflectance_spectrum is None:
                continue
            found.append(
                Layer(
                    name=f"leaves/{name}",
                    things=things,
                    materials=shades(dry, factors, f"leaves/{name}"),
                    cover=1.0 - (1.0 - keys.cover) ** share,
                    leaf=scaled(dry, float(np.mean(factors))),
                    trapped=_TRAPPED.get(str(species.materials[key].leaf_type), _TRAPPED_BY_BLADES),
                    spread=Spread(tilt_deg=16.0, depth_m=0.02, size_sigma=0.18),
                    patch_m=keys.patch_m,
                    where=where,
                )
            )
        return found


def _fallen(request: Request, name: str, species: Species, key: str, rng: np.random.Generator) -> tuple[Thing, ...]:
    """Leaves in a few attitudes and shades."""
    parameters: Any = request.generators[name]
    shapes = [one for one in parameters.shapes.values() if one.material == key]
    if not shapes:
        return ()
    shape = max(shapes, key=lambda one: getattr(one, "length_m", 0.0))
    if hasattr(shape, "needle_length_m") or hasattr(shape, "needles"):
        return _needles(shape, name, rng)
    known, things = type(shape).model_fields, []
    drawn_m = float(getattr(shape, "length_m", 0.1))
    length_m = species.tissue.leaf_length_m or drawn_m
    scale = np.float32(length_m / drawn_m)
    for index, (curl, fold) in enumerate(zip(_CURLS_DEG, _FOLDS_DEG, strict=True)):
        update = {key: value for key, value in (("curl_deg", curl), ("fold_deg", fold)) if key in known}
        if "detail" in known:
            update["detail"] = request.detail(length_m)
        form: OrganForm = shape.model_copy(update=update)
        patches = [one.patch._replace(points=scale * one.patch.points) for one in form.patches()]
        pieces = [sheet(Part.LITTER, f"leaves/{name}-{index}", one) for one in patches]
        things.append(Thing(centred(pieces), length_m))
    return tuple(things)


def _needles(shape: Any, name: str, rng: np.random.Generator) -> tuple[Thing, ...]:
    """Groups of needles, within a decimetre of each other."""
    length_m = getattr(shape, "needle_length_m", None) or shape.length_m
    width_m = getattr(shape, "needle_width_m", None) or shape.width_m
    things = []
    for index in range(len(_SHADES)):
        blade = strip(length_m, np.array([width_m, width_m, 0.0]), folded=False)
        turn, lean = rng.random(_IN_ONE) * 2 * np.pi, rng.normal(0.0, 0.2, _IN_ONE)
        at = np.column_stack([rng.normal(0.0, 0.05, (_IN_ONE, 2)), rng.random(_IN_ONE) * 0.006])
        along = np.column_stack([np.cos(turn) * np.cos(lean), np.sin(turn) * np.cos(lean), np.sin(lean)])
        across = np.column_stack([-np.sin(turn), np.cos(turn), np.zeros(_IN_ONE)])
        linear = np.stack([across, along, np.cross(across, along)], axis=-1)
        patch = copies(blade, linear, at)
        things.append(Thing(centred([sheet(Part.LITTER, f"leaves/{name}-{index}", patch)]), length_m))
    return tuple(things)


LAYER = Leaves()
