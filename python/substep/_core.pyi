from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

level: str
version: str
compiler: str
eigen: str

def num_threads() -> int: ...
def set_num_threads(threads: int) -> None: ...

class CholeskyFactor:
    def __init__(
        self, start: NDArray[Any], row: NDArray[Any], ordering: str, kind: str, block: int
    ) -> None: ...
    def factor(self, values: NDArray[Any]) -> bool: ...
    def solve(self, b: NDArray[Any]) -> NDArray[Any]: ...
    def report(self) -> dict[str, Any]: ...

class LUFactor:
    def __init__(self, start: NDArray[Any], row: NDArray[Any], kind: str) -> None: ...
    def factor(self, values: NDArray[Any]) -> None: ...
    def solve(self, b: NDArray[Any], transpose: bool) -> NDArray[Any]: ...
    def report(self) -> dict[str, Any]: ...

class ComplexLUFactor:
    def __init__(self, start: NDArray[Any], row: NDArray[Any], kind: str) -> None: ...
    def factor(self, values: NDArray[Any]) -> None: ...
    def solve(self, b: NDArray[Any], transpose: bool) -> NDArray[Any]: ...
    def report(self) -> dict[str, Any]: ...

def krylov(
    symmetric: bool,
    a: Any,
    preconditioner: Any,
    b: NDArray[Any],
    guess: NDArray[Any],
    rtol: float,
    atol: float,
    max_iterations: int,
    threads: int,
) -> tuple[NDArray[Any], bool, int, list[float], str]: ...
def find_asymmetry(
    start: NDArray[Any], row: NDArray[Any], values: NDArray[Any], tolerance: float
) -> int: ...
def library_versions() -> dict[str, Any]: ...
def ode_methods() -> list[str]: ...
def ode_method(name: str) -> dict[str, Any]: ...
def tableau(method: str) -> dict[str, Any]: ...
def rkc_formula(stages: int) -> dict[str, Any]: ...

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

class System:
    @property
    def size(self) -> int: ...
    @property
    def native(self) -> bool: ...
    @property
    def second_order(self) -> bool: ...
    def rhs(self, t: float, y: Any) -> Any: ...
    @property
    def has_jacobian(self) -> bool: ...
    def jacobian(self, t: float, y: Any) -> Any: ...
    @property
    def has_jacobian_product(self) -> bool: ...
    def jacobian_product(self, t: float, y: Any, v: Any) -> Any: ...

class PythonSystem(System):
    def __init__(
        self, fun: Any, components: int, complex: bool, args: tuple[Any, ...], convert: Any
    ) -> None: ...

class PointerSystem(System):
    def __init__(self, address: int, size: int, parameters: Any) -> None: ...

class Lorenz(System):
    def __init__(self, sigma: float, rho: float, beta: float) -> None: ...

class Arenstorf(System):
    def __init__(self, mu: float) -> None: ...

class Kepler(System):
    def __init__(self, mu: float) -> None: ...

class HenonHeiles(System):
    def __init__(self, lambda_: float) -> None: ...

class VanDerPol(System):
    def __init__(self, damping: float, stiffness: float) -> None: ...

class Pendulum(System):
    def __init__(self, length: float, gravity: float, damping: float) -> None: ...

class HarmonicOscillator(System):
    def __init__(self, omega: float, damping: float) -> None: ...

class Pleiades(System):
    def __init__(self, masses: list[float]) -> None: ...

class Robertson(System):
    def __init__(self, k1: float, k2: float, k3: float) -> None: ...

class Orego(System):
    def __init__(self, s: float, q: float, w: float) -> None: ...

class Hires(System):
    def __init__(self) -> None: ...

class Brusselator1D(System):
    def __init__(self, n: int, alpha: float, a: float, b: float) -> None: ...

class Brusselator2D(System):
    def __init__(
        self, n: int, alpha: float, a: float, b: float, source: float, source_time: float
    ) -> None: ...

class Jacobian: ...

class ConstantJacobian(Jacobian):
    def __init__(self, columns: tuple[Any, Any] | None, values: Any) -> None: ...

class PythonJacobian(Jacobian):
    def __init__(
        self, function: Any, columns: tuple[Any, Any] | None, components: int, complex: bool
    ) -> None: ...

class PointerJacobian(Jacobian):
    def __init__(
        self, address: int, size: int, parameters: Any, columns: tuple[Any, Any] | None
    ) -> None: ...

class MassMatrix:
    def __init__(self, columns: tuple[Any, Any] | None, values: Any) -> None: ...

def finite_differences(system: System, columns: tuple[Any, Any] | None) -> Jacobian: ...
def group_columns(columns: tuple[Any, Any]) -> Any: ...

class DenseSolution:
    @property
    def times(self) -> Any: ...
    def evaluate(self, t: Any) -> Any: ...

class Integration:
    def __init__(
        self,
        *,
        system: System,
        method: str,
        t: float,
        t_bound: float,
        y0: Any,
        step: float,
        rtol: list[float],
        atol: list[float],
        first_step: float,
        max_step: float,
        threads: int,
        every_step: bool,
        t_eval: list[float],
        dense: bool,
        interpolate: bool,
        spectral_radius: Any = ...,
        jacobian: Jacobian | None = None,
        mass: MassMatrix | None = None,
        krylov: bool = False,
    ) -> None: ...
    def start(self) -> None: ...
    def run(self, steps: int) -> int: ...
    def interpolate(self, t: Any) -> Any: ...
    def step_dense(self) -> DenseSolution: ...
    def truncate(self, t: float) -> None: ...
    @property
    def t(self) -> float: ...
    @property
    def t_old(self) -> float: ...
    @property
    def y(self) -> Any: ...
    @property
    def y_old(self) -> Any: ...
    @property
    def evaluations(self) -> int: ...
    @property
    def jacobians(self) -> int: ...
    @property
    def factorizations(self) -> int: ...
    @property
    def steps(self) -> int: ...
    @property
    def finished(self) -> bool: ...
    def take_times(self) -> Any: ...
    def take_states(self) -> Any: ...
    def take_dense(self) -> DenseSolution: ...

class PythonAcceleration(System):
    def __init__(
        self, fun: Any, shape: Sequence[int], args: tuple[Any, ...], convert: Any
    ) -> None: ...

class PointerAcceleration(System):
    def __init__(self, address: int, components: int, parameters: Any) -> None: ...

class Oscillators(System):
    def __init__(self, omega: Any) -> None: ...

class SpringChain(System):
    def __init__(self, n: int, k: Any, m: Any, fixed_ends: bool) -> None: ...

class NBody(System):
    def __init__(self, masses: Any, G: float, softening: float, dimension: int) -> None: ...

def second_order_methods() -> list[dict[str, Any]]: ...
def solve_second_order(
    *,
    system: System,
    method: str,
    t0: float,
    t1: float,
    x0: Any,
    v0: Any,
    step: float,
    t_eval: Any,
    max_steps: int,
    threads: int,
    callback: Any,
) -> dict[str, Any]: ...
def solve_ensemble(
    *,
    systems: list[System],
    address: int,
    parameters: Any,
    method: str,
    t0: float,
    t1: float,
    y0: Any,
    step: float,
    rtol: list[float],
    atol: list[float],
    first_step: float,
    max_step: float,
    t_eval: list[float],
    max_steps: int,
    threads: int,
) -> tuple[Any, list[tuple[int, str, float, int, int, int]]]: ...

class SampledDistance:
    def __init__(
        self, values: NDArray[Any], origin: list[float], spacing: float, threads: int
    ) -> None: ...
    @property
    def values(self) -> NDArray[Any]: ...
    @property
    def origin(self) -> list[float]: ...
    @property
    def spacing(self) -> float: ...
    @property
    def error_bound(self) -> float: ...

class Collider:
    friction: float
    restitution: float
    position: list[float]
    orientation: list[float]
    velocity: list[float]
    angular_velocity: list[float]
    state: list[float]

    @staticmethod
    def plane(point: list[float], normal: list[float]) -> Collider: ...
    @staticmethod
    def sphere(center: list[float], radius: float, hollow: bool) -> Collider: ...
    @staticmethod
    def box(center: list[float], half_lengths: list[float], hollow: bool) -> Collider: ...
    @staticmethod
    def sampled(field: SampledDistance, position: list[float], hollow: bool) -> Collider: ...
    @property
    def lipschitz(self) -> float: ...
    @property
    def hollow(self) -> bool: ...
    @property
    def impulse(self) -> list[float]: ...
    @property
    def torque(self) -> list[float]: ...
    def copy(self) -> Collider: ...
    def advance(self, dt: float) -> None: ...
    def distance(self, x: NDArray[Any], threads: int) -> NDArray[Any]: ...
    def gradient(self, x: NDArray[Any], threads: int) -> NDArray[Any]: ...
    def hessian(self, x: NDArray[Any], threads: int) -> NDArray[Any]: ...
    def surface_velocity(self, x: NDArray[Any], threads: int) -> NDArray[Any]: ...

class TriangleTree:
    def __init__(self, vertices: NDArray[Any], faces: NDArray[Any]) -> None: ...
    @property
    def closed(self) -> bool: ...
    def nearest(self, x: NDArray[Any], threads: int) -> NDArray[Any]: ...
    def winding_number(self, x: NDArray[Any], threads: int) -> NDArray[Any]: ...
    def signed_distance(self, x: NDArray[Any], threads: int) -> NDArray[Any]: ...
    def count_pierced(
        self, vertices: NDArray[Any], faces: NDArray[Any], edges: NDArray[Any], threads: int
    ) -> int: ...
    def sample(
        self, shape: list[int], origin: list[float], spacing: float, threads: int
    ) -> NDArray[Any]: ...
    def stuff(self, spacing: float, threads: int) -> tuple[NDArray[Any], NDArray[Any]]: ...

class Term: ...

def spring_terms(
    edges: NDArray[Any], stiffness: NDArray[Any], rest_lengths: NDArray[Any], damping: NDArray[Any]
) -> list[Term]: ...

elastic_models: list[str]

def tetrahedra_terms(
    rest: NDArray[Any],
    tetrahedra: NDArray[Any],
    young_modulus: NDArray[Any],
    poisson_ratio: NDArray[Any],
    model: str,
    relaxation_time: float,
) -> list[Term]: ...
def drag_term(rate: float, masses: NDArray[Any]) -> Term: ...

class StepReport:
    converged: bool
    friction_converged: bool
    iterations: int
    factorizations: int
    backtracks: int
    minimisations: int
    failed: int
    residuals: list[float]

class Deformable:
    positions: NDArray[Any]
    velocities: NDArray[Any]
    forces: NDArray[Any]
    targets: NDArray[Any]
    pinned: NDArray[Any]
    time: float
    threads: int
    report: StepReport

    def __init__(
        self,
        positions: NDArray[Any],
        velocities: NDArray[Any],
        masses: NDArray[Any],
        pinned: NDArray[Any],
        terms: list[Term],
        colliders: list[Collider],
        integrator: str,
        solver: str,
        max_iterations: int,
        gravity: list[float],
        tolerance: float,
        max_halvings: int,
        contact_thickness: float,
        contact_stiffness: float,
        sticking_speed: float,
        threads: int,
    ) -> None: ...
    def step(self, dt: float) -> None: ...
    def kinetic_energy(self) -> float: ...
    def potential_energy(self) -> float: ...
    def closest(self) -> float: ...
    def spectrum(self) -> tuple[float, float]: ...
