"""Placement of a community at one moment: what a recipe says, the field that kernels deform, shares of species."""
