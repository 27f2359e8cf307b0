"""Loops compiled by Numba, kept on disk where there is a place for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba.core import cgutils
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function as machine code, which runs without Python's lock."""
    return _compiled(function)


def contracted(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`; a product that is added is rounded once, with the sum, where the processor can do so.

    For kernels that nobody compares bit by bit with those of a processor that cannot (x86 from before 2013).
    """
    return _compiled(function, fastmath={"contract"})


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `contracted`, for small functions: the machine code of whatever calls one contains it."""
    return _compiled(function, fastmath={"contract"}, forceinline=True)


def inlined_exactly(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `inlined`, but every product is rounded: results are the same on every processor."""
    return _compiled(function, forceinline=True)


def unchecked(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`; a division by zero gives infinity and no error, so that loops with one become vector instructions.

    Sums are not re-ordered: results are the same on every processor.
    """
    return _compiled(function, error_model="numpy")


def _compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    try:
        kernel: Callable[..., Any] = numba.njit(cache=True, nogil=True, **options)(function)
    except RuntimeError:  # neither the package nor the home directory can be written to: no place for a cache
        kernel = numba.njit(nogil=True, **options)(function)
    _follow_helpers(kernel, function)
    return kernel


def _follow_helpers(kernel: Any, function: Callable[..., Any]) -> None:
    """Compile a kept kernel again when a helper that its module imports has changed: Numba looks at its own file only.

    The helpers' stamps contain those of their own helpers. Private to Numba; tests/unit/core/test_compiled.py notices
    if it changes there.
    """
    kept, own = _kept(kernel), function.__module__
    helpers = {
        _kept(one)._source_stamp
        for one in function.__globals__.values()
        if isinstance(one, Dispatcher) and one.py_func.__module__ != own and _kept(one) is not None
    }
    if kept is not None and helpers:
        kept._source_stamp = (kept._source_stamp, *sorted(helpers, key=repr))


def _kept(kernel: Any) -> Any:
    """Numba's record of a kernel on disk; None if it is not kept, or not compiled (NUMBA_DISABLE_JIT)."""
    return getattr(getattr(kernel, "_cache", None), "_cache_file", None)


@intrinsic
def borrowed(typing_context, array):  # type: ignore[no-untyped-def]
    """The same array without a claim on its memory, inside compiled code.

    Numba counts references to an array in every call that passes it, with two locked instructions a time: in kernels
    that call small functions for each element that is most of the time. Somebody else must keep the original alive:
    numba frees an array that the kernel itself has made as soon as its own name is not read any more, be it borrowed or
    not. So borrow arguments; what is made inside needs a later reading of its name, in or behind the last loop.
    """

    def code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        view = context.make_array(array)(context, builder, arguments[0])
        view.meminfo = cgutils.get_null_value(view.meminfo.type)
        view.parent = cgutils.get_null_value(view.parent.type)
        return view._getvalue()

    return array(array), code
