"""Recordings in three dimensions: cameras, looks, light, and the stage that PyVista draws."""

from .flat import marker_area, plain_picture
from .look import Camera, CameraPath, Light, Look
from .view import View

__all__ = ["Camera", "CameraPath", "Light", "Look", "View", "marker_area", "plain_picture"]


def __dir__() -> list[str]:
    return __all__
