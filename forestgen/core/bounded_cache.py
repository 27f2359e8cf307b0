"""Arrays kept in memory for those who ask again, up to so many bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class BoundedCache(Generic[T]):
    """The values asked for last. One that is larger than all the room is never kept.

    Parameters
    ----------
    most_bytes : the room.
    bytes_of : a value's size.
    """

    def __init__(self, most_bytes: int, bytes_of: Callable[[T], int]) -> None:
        self.most_bytes = most_bytes
        self._bytes_of = bytes_of
        self._kept: OrderedDict[Hashable, T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of `key`, made if it is not kept."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        value = make()
        with self._lock:
            self._kept[key] = value
            total = sum(self._bytes_of(one) for one in self._kept.values())
            while total > self.most_bytes:
                total -= self._bytes_of(self._kept.popitem(last=False)[1])
        return value

    def clear(self) -> None:
        """Keep nothing of what there is."""
        with self._lock:
            self._kept.clear()

    def __len__(self) -> int:
        return len(self._kept)
