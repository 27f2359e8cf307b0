"""What cannot be combined with light that is traced through the clouds' volume."""

from __future__ import annotations

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import DrawnRecipe


def chooses_exact(drawn: DrawnRecipe) -> bool:
    """Whether a recipe asks for light through its clouds' volume."""
    return drawn.recipe.render.clouds == "exact" and drawn.recipe.sky.clouds.has_clouds


def exact_light_error(what: str, where: str, leave_out: str, *, chosen: bool) -> RecipeError:
    """That it cannot be combined with `what`. `chosen`: by the recipe; else clouds came near the plants."""
    expected, got = "clouds far above the plants", "clouds near the plants"
    hint = f"leave out {leave_out}, or raise the clouds"
    if chosen:
        expected, got, hint = "render.clouds: farfield or auto", "exact", f"{hint} and leave render.clouds out"
    problem = f"light through the clouds' volume cannot be combined with {what}"
    return RecipeError(problem, where=where, expected=expected, got=got, hint=hint)
