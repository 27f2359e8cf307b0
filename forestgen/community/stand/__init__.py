"""Stands by what foresters measure: places of stems, and crowns of a given cover."""
