"""Loops compiled by Numba, kept on disk where there is a place for them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
from numba.core import cgutils, types
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.extending import intrinsic


def compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """The function as machine code, which runs without Python's lock; `options` are those of Numba.

    It is compiled again when its own file changes, or a file from which that file imports a kernel, a named tuple or
    the whole module. So read another file's constants from its module: `layout.FIRST`.
    """
    try:
        kernel: Any = numba.njit(cache=True, nogil=True, **options)(function)
    except RuntimeError:  # neither the package nor the home directory can be written to: no place for a cache
        return numba.njit(nogil=True, **options)(function)  # type: ignore[no-any-return]
    if not hasattr(kernel, "_cache"):  # NUMBA_DISABLE_JIT
        return kernel  # type: ignore[no-any-return]
    index, package = kernel._cache._cache_file, function.__module__.partition(".")[0]
    used = _sources(function.__globals__, f"{package}.", frozenset([function.__module__]))
    stamps = ((path.name, path.stat()) for path in map(Path, sorted(used)))
    index._source_stamp = (index._source_stamp, *((name, one.st_mtime_ns, one.st_size) for name, one in stamps))
    return kernel  # type: ignore[no-any-return]


#: As `compiled`; a product that is added is rounded once, with the sum, where the processor can do so. For kernels
#: whose results need not equal bit by bit those of a processor that cannot (x86 from before 2013).
fma_njit = partial(compiled, fastmath={"contract"})
#: As `fma_njit`, for small functions, whose machine code becomes part of their callers.
inlined = partial(compiled, fastmath={"contract"}, forceinline=True)
#: As `inlined`, but every product is rounded: results are the same on every processor.
inlined_exactly = partial(compiled, forceinline=True)
#: As `compiled`; a division by zero gives infinity and no error, so that loops with one become vector instructions.
#: Sums are not re-ordered: results are the same on every processor.
unchecked = partial(compiled, error_model="numpy")


def _sources(names: dict[str, Any], package: str, seen: frozenset[str]) -> set[str]:
    """Files of the package's modules to which a module's names refer, or in which they are kernels or tuples."""
    modules = {_module_of(value) for value in names.values()} - seen
    found = set()
    for module in modules:
        inner = vars(sys.modules[module]) if module.startswith(package) and module in sys.modules else {}
        if inner and "__path__" not in inner:
            found |= {inner["__file__"]} | _sources(inner, package, seen | modules)
    return found


def _module_of(value: object) -> str:
    if isinstance(value, ModuleType):
        return value.__name__
    is_tuple = isinstance(value, type) and issubclass(value, tuple)
    return value.__module__ if is_tuple or isinstance(value, Dispatcher | _Intrinsic) else ""


@inlined_exactly
def assign(to, values):  # type: ignore[no-untyped-def]
    """`to[:] = values` of one axis, inside compiled code.

    Numba's own statement compiles the text of its error message, in each process, for 2 to 6 s.
    """
    for i in range(len(to)):
        to[i] = values[i]


@intrinsic
def unowned_view(typing_context, arrays):  # type: ignore[no-untyped-def]
    """The same array, or tuple of arrays and numbers, without a claim on its memory, inside compiled code.

    Numba counts references to an array in every call that passes it, by two locked instructions; in kernels that call
    small functions for each element this takes most of the time. The caller must keep the original alive: numba frees
    an array that the kernel itself made once its name is no longer read, even if it has a view. So take views of
    arguments; for an array made inside, read its name again in or after the last loop.
    """

    def code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return _without_claim(context, builder, arrays, arguments[0])

    return arrays(arrays), code


def _without_claim(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
        members = cgutils.unpack_tuple(builder, value)
        parts = [_without_claim(context, builder, *one) for one in zip(kind.types, members, strict=True)]
        return context.make_tuple(builder, kind, parts)
    if not isinstance(kind, types.Array):
        return value
    view = context.make_array(kind)(context, builder, value)
    view.meminfo = cgutils.get_null_value(view.meminfo.type)
    view.parent = cgutils.get_null_value(view.parent.type)
    return view._getvalue()
