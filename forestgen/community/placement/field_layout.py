"""Numbers that the layout of a probability field in memory depends on."""

LANES = 8  # cells of a strip: a line of the processor's memory
SMALLEST = 1e-290  # a cell below is 0: products stay clear of the slow numbers near the smallest
LARGE_PAGE = 2**18  # numbers: what the processor finds the place of at once, where the system gives it
