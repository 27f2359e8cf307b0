"""No module imports one that imports it, however far around: not at its top, in a function, or for type checkers."""

from __future__ import annotations

from graphlib import TopologicalSorter

import grimp


def test_no_import_goes_round_in_a_circle() -> None:
    graph = grimp.build_graph("forestgen", exclude_type_checking_imports=False, cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert len(imports) > 100
    TopologicalSorter(imports).prepare()  # raises CycleError, which names the modules of a circle
