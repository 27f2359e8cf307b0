"""Light wood: fewer triangles, one texture, the same plant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.api.plant_requests import plan_of, request_of
from forestgen.api.plants import grow_files, model_of
from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.geometry import simplify
from forestgen.geometry.simplify import with_light_wood
from forestgen.plants.build import without_stem_details
from forestgen.plants.growing import grow_exemplar
from forestgen.scene.surfaces import materials_of
from support.error_messages import raises_error


def test_wood_has_few_triangles_and_one_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simplify, "ATLAS_PX", 256)
    plan = plan_of("birch", 3)
    species, materials = plan.drawn.species["birch"], materials_of(plan.drawn.species)
    request = request_of(plan, "birch", 4.0, 3)
    # Stubs of dead branches are so small that few triangles make them shorter.
    plant = grow_exemplar(replace(request, parameters=without_stem_details(request.parameters)))
    whole = model_of(plant, species, materials, 3)
    textures = {name: one.texture.colour for (_, name), one in materials.items() if one.texture is not None}
    light = with_light_wood(whole.pieces, textures, 2000)
    assert [piece.name for piece in light] == [piece.name for piece in whole.pieces]
    wood = [piece for piece in light if piece.part in (Part.TRUNK, Part.BRANCH)]
    before = [piece for piece in whole.pieces if piece.part in (Part.TRUNK, Part.BRANCH)]
    assert 0 < sum(piece.mesh.triangles for piece in wood) < 0.8 * sum(piece.mesh.triangles for piece in before)
    assert {piece.surface.name for piece in wood} == {"wood"}
    assert wood[0].surface.colour_image is not None
    for fewer, more in zip(wood, before, strict=True):
        assert fewer.mesh.uv is not None
        assert fewer.mesh.uv.min() >= 0.0
        assert fewer.mesh.uv.max() <= 1.0
        np.testing.assert_allclose(
            np.ptp(fewer.mesh.vertices_m, axis=0), np.ptp(more.mesh.vertices_m, axis=0), rtol=0.1, atol=0.02
        )
    for piece, same in zip(light, whole.pieces, strict=True):
        assert piece in wood or piece is same
    assert replace(whole, pieces=light).surfaces


def test_a_plant_without_bark_stays() -> None:
    plan = plan_of("fireweed", 3)
    species, materials = plan.drawn.species["fireweed"], materials_of(plan.drawn.species)
    whole = model_of(grow_exemplar(request_of(plan, "fireweed", 0.6, 3)), species, materials, 3)
    assert all(one is same for one, same in zip(with_light_wood(whole.pieces, {}, 100), whole.pieces, strict=True))


def test_too_few_triangles_are_refused(tmp_path: Path) -> None:
    with raises_error(RecipeError, place="wood_triangles"):
        grow_files("birch", [tmp_path / "b.glb"], wood_triangles=3, progress=False)
