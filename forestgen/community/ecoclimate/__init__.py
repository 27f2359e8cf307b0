"""Vegetation, soil and climate as one system (docs/adr/0012-ecoclimates.md)."""
