"""Weather on disk: where it lies, and how it is read back."""

from __future__ import annotations

from forestgen.atmosphere.weather import AirGrid, Weather
from forestgen.core.cache import DiskCache, cache_root
from forestgen.core.packed import UnreadableError, unpack

_MOST_BYTES = 4_000_000_000


def weather_store() -> DiskCache | None:
    """Where weather is kept; None if there is no place for it."""
    root = cache_root()
    return None if root is None else DiskCache(root / "weather", _MOST_BYTES)


def read_weather(store: DiskCache, key: str) -> Weather | None:
    """What is kept under a key; None where there is nothing, or nothing that can be read, which is dropped."""
    data = store.read(key)
    if data is None:
        return None
    try:
        found = unpack(data, (Weather, AirGrid))
    except UnreadableError:
        found = None
    if isinstance(found, Weather):
        return found
    store.drop(key)
    return None
