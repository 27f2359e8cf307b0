"""Parts of the world that a label can name. The numbers are written to files: never renumber."""

from __future__ import annotations

from enum import IntEnum


class Part(IntEnum):
    """What a surface is. 0 is nothing: the sky."""

    NOTHING = 0
    GROUND = 1
    TRUNK = 2
    BRANCH = 3
    LEAF = 4
    FLOWER = 5
    FRUIT = 6
    DEAD_WOOD = 7
    LITTER = 8
    ROCK = 9
    WATER = 10
    STRUCTURE = 11  # what people have built
    SURROUNDINGS = 12  # plants outside of the site that have no plant_id
    GROUND_PLANTS = 13  # grass, herbs, seedlings and shrubs of the ground cover, which have no plant_id
    MOSS = 14
