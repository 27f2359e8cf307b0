"""The CUDA devices of this machine."""

from __future__ import annotations

import ctypes
import ctypes.util


def cuda_devices() -> str:
    """Names of the devices; asks the driver itself, because Dr.Jit would log an error where there is none.

    Raises
    ------
    RuntimeError : no driver, or no device.
    """
    path = ctypes.util.find_library("cuda")
    if path is None:
        raise RuntimeError("no CUDA driver")
    driver = ctypes.CDLL(path)
    count = ctypes.c_int(0)
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value == 0:
        raise RuntimeError("a CUDA driver, but no device")
    names = []
    for number in range(count.value):
        device, name = ctypes.c_int(0), ctypes.create_string_buffer(256)
        known = driver.cuDeviceGet(ctypes.byref(device), number) == 0
        known = known and driver.cuDeviceGetName(name, len(name), device) == 0
        names.append(name.value.decode(errors="replace") if known else "unknown")
    return ", ".join(names)
