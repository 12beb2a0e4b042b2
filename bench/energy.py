"""Energy over 1e6 steps of the fixed-step methods: greatest relative error, steps per second."""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
import substep
from substep.systems import HenonHeiles, Kepler

PROBLEMS = {
    "kepler_e0.6_h0.01": (Kepler(eccentricity=0.6), None, 0.01),
    "kepler_e0.9_h0.001": (Kepler(eccentricity=0.9), None, 0.001),
    "henon_heiles_E0.125_h0.05": (
        HenonHeiles(),
        np.array([0.0, 0.1, np.sqrt(2 * (1 / 8 - 0.5 * 0.01 + 0.001 / 3)), 0.0]),
        0.05,
    ),
}
SYMPLECTIC = [entry["name"] for entry in substep._core.second_order_methods()]


def emit(workload: str, peer: str, metric: str, value: Any, unit: str, threads: int = 1) -> None:
    record = dict(workload=workload, peer=peer, metric=metric, value=value, unit=unit)
    print(json.dumps({**record, "threads": threads, "isa": substep._core.level}), flush=True)


def states(system: Any, y0: np.ndarray, method: str, step: float, steps: int) -> np.ndarray:
    """Every step's state, shape (4, steps + 1)."""
    if method in SYMPLECTIC:
        result = substep.solve_second_order(
            system, (0, steps * step), y0[:2], y0[2:], method, step=step
        )
        return np.concatenate([result.x, result.v])
    return substep.solve_ivp(system, (0, steps * step), y0, method, step=step).y


def end_state(system: Any, y0: np.ndarray, method: str, step: float, steps: int) -> Any:
    end = steps * step
    if method in SYMPLECTIC:
        return substep.solve_second_order(
            system, (0, end), y0[:2], y0[2:], method, step=step, t_eval=[end]
        )
    return substep.solve_ivp(system, (0, end), y0, method, step=step, t_eval=[end])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="1e5 steps instead of 1e6")
    steps = 100_000 if parser.parse_args().quick else 1_000_000
    for name, (system, start, step) in PROBLEMS.items():
        y0 = system.y0 if start is None else start
        for method in ["rk4", *SYMPLECTIC]:
            energy = system.energy(states(system, y0, method, step, steps))
            error = np.maximum.accumulate(abs(energy / energy[0] - 1))
            for count in (10**4, 10**5, 10**6):
                if count <= steps:
                    metric = f"max_energy_error_{count}_steps"
                    emit(name, f"substep_{method}", metric, float(error[count]), "1")
            start_time = time.perf_counter()
            end_state(system, y0, method, step, steps)
            rate = steps / (time.perf_counter() - start_time)
            emit(name, f"substep_{method}", "steps_per_s", rate, "1/s")


if __name__ == "__main__":
    main()
