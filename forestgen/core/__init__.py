"""Errors, random streams, caches, registries; imports no other layer."""

__version__ = "0.1.0"
