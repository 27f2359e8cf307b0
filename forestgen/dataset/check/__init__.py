"""Whether a data set is what it claims to be: invariants over its files, and the places where they break.

Each family of invariants is a small module; `run` lists the checks in their order and applies them. The checks
recompute from the files' definitions in plain NumPy. They share no code that computes labels with those who wrote the
files: only the numbers of parts, and readers that are safe with strangers' files.
"""

from forestgen.dataset.check.files import Finding
from forestgen.dataset.check.run import MOST_NAMED, Report, check_dataset

__all__ = ["MOST_NAMED", "Finding", "Report", "check_dataset"]
