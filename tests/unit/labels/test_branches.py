"""Which module and segment lies under a pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forestgen.architecture.prototypes import MOST_NODES
from forestgen.labels.channels.surface import branch_labels
from forestgen.render.identity.surface import empty_surface
from support.scenes import simple_tree


def test_a_pixel_has_the_module_and_node_of_its_triangle():
    rng = np.random.default_rng(0)
    plain, tree = (simple_tree("a", 5.0, 30, rng) for _ in range(2))
    sizes = [organ.mesh.triangles for organ in tree.organs]
    marks = rng.integers(0, 4000, sum(sizes)).astype(np.uint32)
    parts = np.split(marks, np.cumsum(sizes)[:-1])
    organs = tuple(replace(organ, mark=part) for organ, part in zip(tree.organs, parts, strict=True))
    marked = replace(tree, organs=organs)
    exemplars = (plain, marked, replace(marked, is_unique=True))
    which = rng.integers(0, 4, (6, 7)).astype(np.uint32)
    face = rng.integers(0, min(plain.triangles, tree.triangles), (6, 7)).astype(np.uint32)
    found = branch_labels(replace(empty_surface(6, 7), exemplar=which, face=face), exemplars)
    for y, x in np.ndindex(6, 7):
        shows = which[y, x] >= 2
        mark = int(marks[face[y, x]]) if shows else 0
        assert found.module[y, x] == (mark // MOST_NODES + 1 if shows else 0)
        assert found.node[y, x] == mark % MOST_NODES
        assert found.is_own[y, x] == (which[y, x] == 3)
