"""Placement of a community at one moment: densities, sizes, kernels, the field that kernels deform.

`density_map`, `kernels` and `densities` have what a recipe says, `model` what placement models have in common; `field`
draws and deforms, `labelling` shares places among species.
"""
