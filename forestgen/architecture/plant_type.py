"""Plant types, as architecture and what builds on it know them; they lie in the recipe, as species files do."""

from forestgen.recipe.species import PlantType as PlantType
