"""Placement of a community at one moment: densities, sizes, kernels, the field that kernels deform.

A recipe's part is in `stands`, `density_map` and `kernels`; `densities` makes numbers of it, `model` is what placement
models have in common, `field` draws and deforms; `gridded`, `lattice`, `labelling` and `apart` serve the relatives.
"""
