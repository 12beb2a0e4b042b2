"""Rigid bodies: the time of a step in small worlds, and how exact they are then.

Two boxes, a stack of ten, a ragdoll with 14 joints on the ground, a chain of 100 hinges that is let
go level, and 100 ragdolls; no limits at the joints. substep steps by 1/60 s with its defaults but
for sleep, which is off; PyBullet and MuJoCo by 1/240 s; MuJoCo's RK4, in the chain alone, by 1/480
s, where it is about as exact. "step" is the mean time of a step, "second" the time that a simulated
second takes. At the end "penetration" is the deepest contact, and "joint_error" how far a joint is
off (0 where joints are coordinates); "energy_error" of the chain is the largest change of energy in
3 s, looked at 60 times a second, over what it swings with, M g L / 2.

Peers run by the Python of SUBSTEP_PEER_PYTHON, or this one, one thread. Prints JSON lines
{workload, peer, metric, value, unit, threads, isa}, and all of it as a table at the end.
python bench/rigid_small.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import _rigid_scenes as scenes
import numpy as np
import substep
from substep import _core, rigid

HERE = Path(__file__).resolve().parent
H = 1 / 60
PEERS = {"mujoco": "MuJoCo", "mujoco-rk4": "MuJoCo RK4", "pybullet": "PyBullet"}
COLUMNS = {
    "step": "step [us]",
    "second": "second [ms]",
    "joint_error": "joint error",
    "energy_error": "energy error",
    "penetration": "penetration [m]",
}


def emit(workload: str, peer: str, metric: str, value: float, unit: str) -> None:
    record = dict(workload=workload, peer=peer, metric=metric, value=float(f"{value:.4g}"))
    isa = _core.level if peer == "substep" else "native"
    print(json.dumps({**record, "unit": unit, "threads": 1, "isa": isa}), flush=True)


def world_of(boxes: Any, trees: Any, floor: bool) -> substep.RigidBodies:
    world = substep.RigidBodies(step=H, threads=1, sleeping=False)
    if floor:
        world.add(rigid.Plane(), (0, 0, 0), motion="static")
    for _, half, at, q, mass in boxes:
        world.add(rigid.Box(2 * np.array(half)), at, q, mass=mass)
    for tree in trees:
        ids = []
        for parent, joint, anchor, axis, ends, radius, mass in tree:
            along = ends[1] - ends[0]
            shape = rigid.Capsule(radius, float(np.linalg.norm(along)))
            touching = {} if floor else {"group": 0, "mask": 0}
            q = scenes.turn_to(along)
            ids.append(world.add(shape, ends.mean(axis=0), q, mass=mass, **touching))
            if joint:
                other = None if parent == -1 else ids[parent]
                turning = {"axis": axis} if joint == "hinge" else {}
                getattr(world, joint)(ids[-1], other, anchor, **turning)
    return world


def report(workload: str, peer: str, record: dict[str, Any]) -> dict[str, float]:
    """What was measured, by its name."""
    _, trees, floor = scenes.SMALL[workload]
    units = {"step": "us", "second": "ms"}
    values = {"step": record["step"], "second": 1e-3 * record["step"] / record["h"]}
    if floor:
        values["penetration"], units["penetration"] = record["depth"], "m"
    if trees:
        values["joint_error"], units["joint_error"] = record.get("joint", 0.0), "m or rad"
    if trees and not floor:
        mass, length = sum(part[6] for part in trees[0]), 0.1 * len(trees[0])
        values["energy_error"] = record["energy_change"] / (mass * 9.81 * length / 2)
        units["energy_error"] = "1"
    for metric, value in values.items():
        emit(workload, peer, metric, value, units[metric])
    return values


def print_table(rows: list[tuple[str, str, dict[str, float]]]) -> None:
    print("| scene | engine | " + " | ".join(COLUMNS.values()) + " |")
    print("|---" * (2 + len(COLUMNS)) + "|")
    for workload, peer, values in rows:
        cells = (f"{values[metric]:.3g}" if metric in values else "" for metric in COLUMNS)
        print(f"| {workload} | {peer} | " + " | ".join(cells) + " |")


def ours(workload: str, seconds: float) -> dict[str, Any]:
    world = world_of(*scenes.SMALL[workload])
    world.step()
    before, steps = time.perf_counter(), round(seconds / H)
    world.advance((steps - 1) * H)
    mean = 1e6 * (time.perf_counter() - before) / (steps - 1)
    last = world.diagnostics()
    record = {"step": mean, "h": H, "depth": last["penetration"], "joint": last["joint_error"]}
    if not scenes.SMALL[workload][2]:
        world = world_of(*scenes.SMALL[workload])
        energies = [world.diagnostics()["energy"]]
        for _ in range(min(steps, 180)):
            world.step()
            energies.append(world.diagnostics()["energy"])
        record["energy_change"] = max(abs(e - energies[0]) for e in energies)
    return record


def theirs(engine: str, workload: str, seconds: float) -> dict[str, Any] | None:
    python = os.environ.get("SUBSTEP_PEER_PYTHON", sys.executable)
    command = [python, str(HERE / "_rigid_small_peers.py"), engine, workload, str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True)
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode or not lines:
        reason = (done.stderr.strip().splitlines() or ["nothing was printed"])[-1]
        print(f"# {PEERS[engine]} is left out of {workload}: {reason}")
        return None
    record: dict[str, Any] = json.loads(lines[-1])
    return record


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    seconds = 0.5 if parser.parse_args().quick else 5.0
    rows = []
    for workload in scenes.SMALL:
        found: dict[str, Any] = {"substep": ours(workload, seconds)}
        for engine, peer in PEERS.items():
            if engine != "mujoco-rk4" or workload == "hinges 100":
                found[peer] = theirs(engine, workload, seconds)
        for peer, record in found.items():
            if record:
                rows.append((workload, peer, report(workload, peer, record)))
    print_table(rows)


if __name__ == "__main__":
    main()
