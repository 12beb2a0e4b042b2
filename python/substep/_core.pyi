from typing import Any

from numpy.typing import NDArray

level: str
version: str
compiler: str
eigen: str

def num_threads() -> int: ...
def set_num_threads(threads: int) -> None: ...
def ode_methods() -> list[str]: ...
def tableau(method: str) -> dict[str, Any]: ...

advection_methods: dict[str, tuple[list[list[float]], list[float], list[float], float]]

class _Flow:
    def velocity(self, t: float, x: NDArray[Any], threads: int) -> NDArray[Any]: ...
    def advect(
        self,
        x: NDArray[Any],
        origin: float,
        h: float,
        first: int,
        count: int,
        method: str,
        threads: int,
    ) -> NDArray[Any]: ...

class RigidRotation2(_Flow):
    def __init__(self, omega: list[float], center: list[float]) -> None: ...

class RigidRotation3(_Flow):
    def __init__(self, omega: list[float], center: list[float]) -> None: ...

class Shear2(_Flow):
    def __init__(self, rate: float, flow: int, gradient: int) -> None: ...

class Shear3(_Flow):
    def __init__(self, rate: float, flow: int, gradient: int) -> None: ...

class TaylorGreen(_Flow):
    def __init__(self, u: float, k: float, nu: float) -> None: ...

class Abc(_Flow):
    def __init__(self, a: float, b: float, c: float) -> None: ...

class DoubleGyre(_Flow):
    def __init__(self, a: float, epsilon: float, omega: float) -> None: ...

class GridLevel64: ...
class GridLevel32: ...

class Grid2_64:
    level_bytes: int

    def __init__(
        self,
        nodes: list[list[float]],
        wrap: list[float],
        closed: list[bool],
        cubic: bool,
        radius: float,
    ) -> None: ...
    def pack(self, values: NDArray[Any], threads: int) -> Any: ...
    def order(self, x: NDArray[Any], threads: int) -> NDArray[Any]: ...
    def velocity(
        self, levels: list[Any], times: list[float], t: float, x: NDArray[Any], threads: int
    ) -> NDArray[Any]: ...
    def advect(
        self,
        levels: list[Any],
        times: list[float],
        x: NDArray[Any],
        status: NDArray[Any],
        stop_time: NDArray[Any],
        order: NDArray[Any] | None,
        origin: float,
        h: float,
        first: int,
        count: int,
        method: str,
        threads: int,
    ) -> tuple[Any, ...]: ...

Grid2_32 = Grid2_64
Grid3_32 = Grid2_64
Grid3_64 = Grid2_64
