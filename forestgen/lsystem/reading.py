"""A file's front end by its suffix: .lsys in cpfg's conventions, .sys as in Randleff-Rasmussen 2004."""

from __future__ import annotations

from pathlib import Path

from forestgen.lsystem.parsing import parse_file
from forestgen.lsystem.syntax import Listing


def read_listing(path: Path) -> Listing:
    """The program in a file.

    Raises
    ------
    AssetError : there is no such file, or it cannot be read.
    LsystemError : it is not understood; with line and column.
    """
    if path.suffix == ".sys":
        from forestgen.lsystem.sys_format import parse_sys_file

        return parse_sys_file(path)
    return parse_file(path)
