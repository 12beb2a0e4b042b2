"""XPBD on a bar of tetrahedra: 21 x 6 x 6 vertices, each cell cut in five, held at one end.

Edges and volumes (6205 constraints, as pyPBD's mode 6), h = 1/60 s in ten substeps of one
iteration, float32; also neo-Hookean tetrahedra (two constraints each), and float64. Whole steps are
timed, through the Python API. Prints JSON lines {workload, peer, metric, value, unit, threads,
isa}. pyPBD is run where its script is at hand (SUBSTEP_PEERS_SOLIDS, or ../shared/peers/solids)
by the Python that SUBSTEP_PEER_PYTHON names. python bench/pbd_tets.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import time
from pathlib import Path

import numpy as np
import substep
from substep import _core, pbd

SOURCES = Path(__file__).resolve().parents[2] / "shared/peers/solids"
CELLS = (20, 5, 5)
FRAMES = 30
FIVE = {  # corners x + 2 y + 4 z of the cells of either parity
    0: [(0, 1, 2, 4), (3, 1, 2, 7), (5, 1, 4, 7), (6, 2, 4, 7), (1, 2, 4, 7)],
    1: [(1, 0, 3, 5), (2, 0, 3, 6), (4, 0, 5, 6), (7, 3, 5, 6), (0, 3, 5, 6)],
}


def emit(peer: str, metric: str, value: float, unit: str, threads: int, isa: str) -> None:
    record = dict(workload="tetrahedra 21x6x6", peer=peer, metric=metric)
    value = float(f"{value:.4g}")
    print(json.dumps({**record, "value": value, "unit": unit, "threads": threads, "isa": isa}))


def bar() -> substep.geometry.TetMesh:
    """4 m x 1 m x 1 m."""
    counts = np.array(CELLS) + 1
    axes = [np.linspace(0, side, n) for side, n in zip((4.0, 1.0, 1.0), counts, strict=True)]
    vertices = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    tets = []
    for cell in np.ndindex(*CELLS):
        corner = [
            np.ravel_multi_index(np.add(cell, (k & 1, k >> 1 & 1, k >> 2 & 1)), counts)
            for k in range(8)
        ]
        tets += [[corner[k] for k in tet] for tet in FIVE[sum(cell) % 2]]
    return substep.geometry.TetMesh(vertices, tets)


def ours(kind: str, dtype: str, threads: int, repeats: int) -> None:
    mesh = bar()
    elastic = {"young_modulus": 1e6, "poisson_ratio": 0.3} if kind == "neo_hookean" else {}
    constraints = pbd.soft_body(mesh, **elastic)
    count = 2 * len(mesh.tetrahedra) if elastic else sum(len(c) for c in constraints)
    sim = substep.PositionBasedDynamics(
        mesh.vertices,
        1.0,
        constraints,
        pinned=mesh.vertices[:, 0] == 0,
        dtype=dtype,
        threads=threads,
    )
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(FRAMES):
            sim.step()
        best = min(best, (time.perf_counter() - start) / FRAMES)
    name = f"substep {kind} {dtype}"
    emit(name, "time_per_constraint", best / (count * 10) * 1e9, "ns", threads, _core.level)
    emit(name, "time_per_frame", best * 1e3, "ms", threads, _core.level)


def peer(threads: int, repeats: int) -> None:
    script = Path(os.environ.get("SUBSTEP_PEERS_SOLIDS", SOURCES)) / "pypbd_bench.py"
    python = os.environ.get("SUBSTEP_PEER_PYTHON")
    if not python or not script.exists():
        print("# pyPBD is left out: name a Python that has it in SUBSTEP_PEER_PYTHON")
        return
    best: dict[str, float] = {}
    for _ in range(repeats):
        done = subprocess.run(
            [python, str(script), "tet", "21", "6", "6", "10", "1", str(FRAMES)],
            env={**os.environ, "OMP_NUM_THREADS": str(threads)},
            capture_output=True,
            text=True,
        )
        if done.returncode != 0:
            print("# pyPBD is left out: it failed")
            return
        record = json.loads(done.stdout.splitlines()[-1])
        assert record["constraints"] == 6205
        best = min(best or record, record, key=lambda r: r["value"])
    emit("pyPBD", "time_per_constraint", best["value"], "ns", threads, "wheel")
    emit("pyPBD", "time_per_frame", best["ms_per_frame"], "ms", threads, "wheel")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    repeats = 5 if parser.parse_args().quick else 20
    for threads in (1, 2):
        for kind in ("edges_and_volumes", "neo_hookean"):
            for dtype in ("float32", "float64"):
                ours(kind, dtype, threads, repeats)
        peer(threads, 2 if repeats == 5 else 5)


if __name__ == "__main__":
    main()
