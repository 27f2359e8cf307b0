"""Placement of a community at one moment: densities, sizes, kernels, the field that kernels deform."""
