"""Whether OpenGL can draw here without a window.

VTK ends the process where it cannot, so it is asked for nothing before. EGL draws on a device, of
which Mesa offers one in software (EGL_EXT_device_enumeration, EGL_EXT_platform_device).
"""

from __future__ import annotations

import ctypes
import functools
from typing import Any

PLATFORM_DEVICE = 0x313F  # EGL_PLATFORM_DEVICE_EXT
PACKAGES = "Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri"


@functools.cache
def window_class() -> str:
    """VTK's class of windows that are not shown, or an ImportError that says what to install."""
    if why := _why_not_egl():
        try:
            ctypes.CDLL("libOSMesa.so.8")
        except OSError:
            raise ImportError(
                f"{why}, so pictures cannot be drawn without a window; {PACKAGES}"
            ) from None
        return "vtkOSOpenGLRenderWindow"
    return "vtkEGLRenderWindow"


def _why_not_egl() -> str:
    """What is missing; empty if nothing is."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return "libEGL.so.1 is missing"
    pointer, number = ctypes.c_void_p, ctypes.c_int
    egl.eglGetProcAddress.restype = pointer

    def function(name: bytes, result: Any, *arguments: Any) -> Any:
        address = egl.eglGetProcAddress(name)
        return address and ctypes.CFUNCTYPE(result, *arguments)(address)

    query = function(b"eglQueryDevicesEXT", number, number, pointer, ctypes.POINTER(number))
    display = function(b"eglGetPlatformDisplayEXT", pointer, number, pointer, pointer)
    if not query or not display:
        return "libEGL.so.1 knows no devices"
    egl.eglInitialize.argtypes = (pointer, pointer, pointer)
    count, devices = number(), (pointer * 16)()
    query(16, devices, ctypes.byref(count))
    for device in devices[: count.value]:
        if egl.eglInitialize(display(PLATFORM_DEVICE, device, None), None, None):
            return ""
    return "EGL has no driver"
