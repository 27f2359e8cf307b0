"""Estimating density and deformation kernels from a measured stand."""
