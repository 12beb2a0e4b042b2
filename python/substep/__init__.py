"""Time integration and physics simulation for Python with a C++ core."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

# Public names by module. Each module is imported when one of its names is first used, so that
# `import substep` costs milliseconds.
_EXPORTS = {
    "config": ("num_threads", "set_num_threads", "show_config", "state_hash"),
    "errors": (
        "ConvergenceError",
        "CorruptError",
        "FormatError",
        "InputError",
        "NonFiniteError",
        "SingularMatrixError",
        "SolverError",
        "StartWarning",
        "SubstepError",
        "TruncatedError",
        "VersionError",
    ),
    "batch": ("Batch",),
    "coupling": ("World",),
    "export": ("pack",),
    "ode": (
        "EnsembleResult",
        "OdeResult",
        "OdeSolution",
        "SecondOrderResult",
        "solve_ensemble",
        "solve_ivp",
        "solve_second_order",
    ),
    "recording": ("Logger", "Part", "Recorder", "Recording"),
    "fields": (
        "ABC",
        "Advection",
        "AdvectionResult",
        "CurvilinearField",
        "DoubleGyre",
        "GridField",
        "RigidRotation",
        "Shear",
        "TaylorGreen",
        "advect",
        "open_field",
    ),
    "geometry": (
        "Box",
        "Capsule",
        "Collider",
        "ConvexHull",
        "Cylinder",
        "HeightField",
        "Plane",
        "SignedDistanceField",
        "Sphere",
        "TriangleMesh",
        "liquid_surface",
    ),
    "gridfluid": ("GridFlow", "GridLiquid"),
    "mpm": ("MaterialPointMethod",),
    "pbd": ("Distance", "PositionBasedDynamics"),
    "pbf": ("Emitter", "PositionBasedFluid", "Sink", "fill_box", "fill_mesh", "relax"),
    "rigid": ("RigidBatch", "RigidBodies"),
    "springs": ("MassSpring", "SoftBody"),
    "sweeps": ("RunCollection", "sweep"),
    "view": ("show",),
    "ode.scipy_solvers": (
        "DOP853",
        "RK4",
        "RK45",
        "Euler",
        "Heun",
        "ImplicitEuler",
        "Midpoint",
        "Radau",
    ),
}
_MODULE_OF = {name: module for module, names in _EXPORTS.items() for name in names}
_SUBMODULES = (
    "cli",
    "config",
    "coupling",
    "ensemble",
    "errors",
    "export",
    "fields",
    "geometry",
    "gridfluid",
    "linalg",
    "mpm",
    "ode",
    "pbd",
    "pbf",
    "recording",
    "render",
    "rigid",
    "scenes",
    "second_order",
    "springs",
    "stability",
    "sweeps",
    "systems",
    "validate",
)

__all__ = sorted([*_MODULE_OF, *_SUBMODULES])

if TYPE_CHECKING:  # `as` says that a name is for users
    __version__: str

    from . import (
        _core as _core,
        cli as cli,
        config as config,
        coupling as coupling,
        ensemble as ensemble,
        errors as errors,
        export as export,
        fields as fields,
        geometry as geometry,
        gridfluid as gridfluid,
        linalg as linalg,
        mpm as mpm,
        ode as ode,
        pbd as pbd,
        pbf as pbf,
        recording as recording,
        render as render,
        rigid as rigid,
        scenes as scenes,
        second_order as second_order,
        springs as springs,
        stability as stability,
        sweeps as sweeps,
        systems as systems,
        validate as validate,
    )
    from .batch import Batch as Batch
    from .config import (
        num_threads as num_threads,
        set_num_threads as set_num_threads,
        show_config as show_config,
        state_hash as state_hash,
    )
    from .coupling import World as World
    from .errors import (
        ConvergenceError as ConvergenceError,
        CorruptError as CorruptError,
        FormatError as FormatError,
        InputError as InputError,
        NonFiniteError as NonFiniteError,
        SingularMatrixError as SingularMatrixError,
        SolverError as SolverError,
        SubstepError as SubstepError,
        TruncatedError as TruncatedError,
        VersionError as VersionError,
    )
    from .export import (
        pack as pack,
    )
    from .fields import (
        ABC as ABC,
        Advection as Advection,
        AdvectionResult as AdvectionResult,
        CurvilinearField as CurvilinearField,
        DoubleGyre as DoubleGyre,
        GridField as GridField,
        RigidRotation as RigidRotation,
        Shear as Shear,
        TaylorGreen as TaylorGreen,
        advect as advect,
        open_field as open_field,
    )
    from .geometry import (
        Box as Box,
        Capsule as Capsule,
        Collider as Collider,
        ConvexHull as ConvexHull,
        Cylinder as Cylinder,
        HeightField as HeightField,
        Plane as Plane,
        SignedDistanceField as SignedDistanceField,
        Sphere as Sphere,
        TriangleMesh as TriangleMesh,
        liquid_surface as liquid_surface,
    )
    from .mpm import (
        MaterialPointMethod as MaterialPointMethod,
    )
    from .ode import (
        EnsembleResult as EnsembleResult,
        OdeResult as OdeResult,
        OdeSolution as OdeSolution,
        SecondOrderResult as SecondOrderResult,
        solve_ensemble as solve_ensemble,
        solve_ivp as solve_ivp,
        solve_second_order as solve_second_order,
    )
    from .ode.scipy_solvers import (
        DOP853 as DOP853,
        RK4 as RK4,
        RK45 as RK45,
        Euler as Euler,
        Heun as Heun,
        ImplicitEuler as ImplicitEuler,
        Midpoint as Midpoint,
        Radau as Radau,
    )
    from .pbd import (
        Distance as Distance,
        PositionBasedDynamics as PositionBasedDynamics,
    )
    from .pbf import (
        Emitter as Emitter,
        PositionBasedFluid as PositionBasedFluid,
        Sink as Sink,
        fill_box as fill_box,
        fill_mesh as fill_mesh,
        relax as relax,
    )
    from .recording import (
        Logger as Logger,
        Part as Part,
        Recorder as Recorder,
        Recording as Recording,
    )
    from .rigid import (
        RigidBatch as RigidBatch,
        RigidBodies as RigidBodies,
    )
    from .springs import (
        MassSpring as MassSpring,
        SoftBody as SoftBody,
    )
    from .sweeps import (
        RunCollection as RunCollection,
        sweep as sweep,
    )
    from .view import show as show


def __getattr__(name: str) -> Any:
    if name == "_core":
        from .base.native import load

        value: Any = load()
    elif name == "__version__":  # pyproject.toml has it, and the build gives it to the core
        value = __getattr__("_core").version
    elif name in _MODULE_OF:
        value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    elif name in _SUBMODULES:
        value = importlib.import_module(f".{name}", __name__)
    else:
        raise AttributeError(f"module 'substep' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
