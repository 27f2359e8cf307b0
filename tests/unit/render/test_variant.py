"""Which variant traces identity."""

from __future__ import annotations

import pytest

from forestgen.core.errors import ResourceError
from forestgen.render import variant
from forestgen.render.variant import CUDA, LLVM, TRACING_ENVIRONMENT, require, tracing_variant
from support.error_messages import raises_error


@pytest.mark.parametrize(("named", "variant"), [(None, LLVM), ("llvm", LLVM), ("cuda", CUDA), ("CUDA", CUDA)])
def test_the_environment_chooses(monkeypatch, named, variant):
    monkeypatch.delenv(TRACING_ENVIRONMENT, raising=False)
    if named is not None:
        monkeypatch.setenv(TRACING_ENVIRONMENT, named)
    assert tracing_variant() == variant


def test_a_device_that_nobody_knows_is_refused(monkeypatch):
    monkeypatch.setenv(TRACING_ENVIRONMENT, "abacus")
    with raises_error(ResourceError):
        tracing_variant()


def test_cuda_without_a_device_is_refused_with_the_way_out(monkeypatch):
    def none() -> str:
        raise RuntimeError("no CUDA driver")

    monkeypatch.setattr(variant, "cuda_devices", none)
    with raises_error(ResourceError):
        require(CUDA)
    require(LLVM)


def test_a_process_that_was_forked_after_an_image_is_refused(monkeypatch):
    """Its renderer would wait for threads that the fork has not copied."""
    monkeypatch.setitem(variant._ready, "process", -1)
    with raises_error(ResourceError):
        variant.mitsuba()
