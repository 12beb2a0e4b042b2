"""What one sees: pictures by PyVista, views in the browser, pages that play, notebooks."""

from .browser import Viewer, show
from .flat import marker_area, plain_picture
from .look import Camera, CameraPath, Light, Look
from .view import View

__all__ = [
    "Camera",
    "CameraPath",
    "Light",
    "Look",
    "View",
    "Viewer",
    "marker_area",
    "plain_picture",
    "show",
]


def __dir__() -> list[str]:
    return __all__
