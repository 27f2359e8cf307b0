"""Conventions of foresters."""

BREAST_HEIGHT_M = 1.3  # at which stems are measured; a plant that does not reach it has none
