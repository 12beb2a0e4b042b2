"""What all shapes share: they are values, and have a place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.attributes import Frozen
from ..base.checks import check_array
from ..base.quaternions import IDENTITY, unit_quaternions
from ..errors import InputError

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]

ORIGIN = (0.0, 0.0, 0.0)


class Shape(Frozen):
    """A region of space: a `Box`, `Sphere`, `Capsule`, `Cylinder`, `Plane`, `ConvexHull`, ...

    Obstacles (`Collider`), sinks and rigid bodies are made of shapes. A shape is a value: it does
    not change, is equal to another of the same numbers, and can be used any number of times.

    Examples
    --------
    >>> import substep
    >>> isinstance(substep.Sphere(0.5), substep.geometry.Shape)
    True
    """

    center: tuple[float, float, float] = ORIGIN
    rotation: tuple[float, float, float, float] = IDENTITY
    _fields: ClassVar[tuple[str, ...]] = ()  # the arguments that it is made of, in their order
    _kind: ClassVar[str | None] = None  # of the native rigid shapes, which is made of _numbers()

    def _set(self, **values: Any) -> None:
        self.__dict__.update(values)
        self._fixed |= values.keys()

    def _place(self, center: ArrayLike, rotation: ArrayLike = IDENTITY) -> None:
        self._set(
            center=tuple(check_array("center", center, (3,)).tolist()),
            rotation=tuple(unit_quaternions("rotation", rotation, (4,)).tolist()),
        )

    def _key(self) -> tuple[Any, ...]:
        values = [getattr(self, name) for name in self._fields]
        return tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in values)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash((type(self), self._key()))

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self

    def __repr__(self) -> str:
        default = {"center": ORIGIN, "point": ORIGIN, "rotation": IDENTITY}
        given = []
        for name in self._fields:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                given.append(f"{len(value)} {name}")
            elif name not in default or value != default[name]:
                given.append(f"{name}={value}")
        return f"{type(self).__name__}({', '.join(given)})"

    def _obstacle(self, hollow: bool) -> Any:
        """An obstacle of the native core, in the place of the shape."""
        raise InputError(f"shape: a {type(self).__name__} cannot be an obstacle")

    def _rigid(self) -> tuple[Any, Array, Array]:
        """A shape of the native rigid bodies, and its place in their frame."""
        return self._rigid_shape(), np.array(self.center), np.array(self.rotation)

    def _rigid_shape(self) -> Any:
        if self._kind is None:
            raise InputError(f"shape: a {type(self).__name__} cannot be a rigid body")
        return _core.RigidShape(self._kind, self._numbers())

    def _numbers(self) -> dict[str, float]:
        """What the native rigid shape is made of."""
        raise NotImplementedError

    def _moments(self, density: float) -> Any:
        """Mass, centre and inertia in the frame of the shape."""
        raise InputError(f"shape: a {type(self).__name__} has no mass")
