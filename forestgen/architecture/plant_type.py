"""Plant types, as architecture and what builds on it know them; they lie in the recipe, as species files do."""

from forestgen.recipe.plant_type import PlantType as PlantType
