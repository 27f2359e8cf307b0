"""Light paths of a whole image at once, over the same flat tables as the identity pass.

All paths of a block of pixels go one scattering further together, as arrays of Dr.Jit, and those that ended are
dropped. A kernel knows no instance and no material: what a hit means is looked up (`render/identity/tracer.py`,
`surface_tables.py`). So one kernel serves any scene. It runs on LLVM; on CUDA it has not been tried. ADR 0013 has the
measurements.
"""
