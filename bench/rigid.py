"""Rigid bodies: stacks, a pyramid, piles, growth and batches; and how exact they are.

substep steps by 1/60 s with its defaults but for sleep, which is off, as in the peers: nothing is
gained by bodies at rest. "step" is the mean time of a step, "settled" that of the last second,
"second" the time that a simulated second takes. "drift" and "sinking" are the largest movement of a
box sideways and downwards, "late_overlap" the deepest contact in the last quarter.

Peers run by the Python of SUBSTEP_PEER_PYTHON, one thread: PyBullet and MuJoCo in the scenes of
rigid_scenes.py (SUBSTEP_PEERS_SOLIDS or ../shared/peers/solids) at 1/240 s, below which both fail,
and the piles and batches of _rigid_peers.py. Prints JSON lines {workload, peer, metric, value,
unit, threads, isa}.
python bench/rigid.py [--quick]
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import math
import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import _rigid_scenes as scenes
import numpy as np
import substep
from substep import _core, rigid

HERE = Path(__file__).resolve().parent
SOURCES = HERE.parents[1] / "shared/peers/solids"
H = 1 / 60
SHAPES = {
    "box": lambda half: rigid.Box(2 * np.array(half)),
    "sphere": lambda size: rigid.Sphere(*size),
    "capsule": lambda size: rigid.Capsule(size[0], 2 * size[1]),  # of a radius and half a length
}
BULLET, BULLET_MAXC, MUJOCO = "PyBullet", "PyBullet maxc", "MuJoCo"


def emit(
    workload: str,
    peer: str,
    metric: str,
    value: float,
    unit: str,
    threads: int = 1,
    digits: int = 4,
) -> None:
    shown = float(f"{value:.{digits}g}")
    record = dict(workload=workload, peer=peer, metric=metric, value=shown)
    isa = _core.level if peer.startswith("substep") else "native"
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": isa}), flush=True)


def world_of(
    bodies: Any, walls: Any = (), threads: int = 1, **options: Any
) -> tuple[substep.RigidBodies, Any]:
    """The bodies on a floor, none of which sleeps, and their numbers."""
    made = {key: options.pop(key) for key in ("friction", "restitution") if key in options}
    world = substep.RigidBodies(threads=threads, sleeping=False, **options)
    world.add(rigid.Plane(), (0, 0, 0), motion="static", **made)
    for half, at in walls:
        world.add(rigid.Box(2 * np.array(half)), at, motion="static", **made)
    ids = [
        world.add(SHAPES[kind](size), at, q, mass=mass, **made)
        for kind, size, at, q, mass in bodies
    ]
    return world, np.array(ids)


def overlap(world: substep.RigidBodies) -> float:
    """The deepest contact [m]."""
    return max(0.0, -float(world.contacts().separations.min(initial=0.0)))


def run(workload: str, bodies: Any, walls: Any, seconds: float, threads: int) -> None:
    """Times, and how far the bodies moved, overlapped and fell."""
    world, ids = world_of(bodies, walls, threads)
    start, steps = world.positions[ids].copy(), round(seconds / H)
    times, late = np.empty(steps), 0.0
    for k in range(steps):
        before = time.perf_counter()
        world.step(H)
        times[k] = time.perf_counter() - before
        if k > 0.75 * steps:
            late = max(late, overlap(world))
    last = times[-min(steps, round(1 / H)) :]
    emit(workload, "substep", "step", 1e3 * times.mean(), "ms", threads)
    emit(workload, "substep", "settled", 1e3 * last.mean(), "ms", threads)
    emit(workload, "substep", "second", 1e3 * times.mean() / H, "ms", threads)
    moved = world.positions[ids] - start
    emit(workload, "substep", "late_overlap", late, "m", threads)
    if not walls:
        emit(workload, "substep", "drift", np.abs(moved[:, :2]).max(), "m", threads)
        emit(workload, "substep", "sinking", -moved[:, 2].min(), "m", threads)
        emit(workload, "substep", "fallen", (moved[:, 2] < -0.3).sum(), "1", threads)


def piles(quick: bool) -> None:
    seconds = 1 if quick else 3
    for name, kinds in (("boxes", ["box"]), ("mixed", ["sphere", "box", "capsule"])):
        for threads in (1, 2):
            run(f"pile 1000 {name}", *scenes.pile(1000, kinds), seconds, threads)


def standing(quick: bool) -> None:
    seconds = 1 if quick else 10
    run("stack 10", scenes.stack(10), (), seconds, 1)
    run("stack 20", scenes.stack(20), (), seconds, 1)
    run("mass ratio 1000", scenes.stack(2, (1.0, 1000.0)), (), seconds, 1)
    for threads in (1, 2):
        run("pyramid 210", scenes.pyramid(20), (), seconds, threads)


def growth(sizes: list[int], seconds: float) -> None:
    """The time of a simulated second while a pile falls together."""
    for count in sizes:
        for threads in (1, 2):
            world, _ = world_of(*scenes.pile(count, ["box"]), threads=threads)
            start = time.perf_counter()
            for _ in range(round(seconds / H)):
                world.step(H)
            spent = (time.perf_counter() - start) / seconds
            emit(f"growth {count}", "substep", "second", 1e3 * spent, "ms", threads)


def batch(worlds: int, seconds: float) -> None:
    """World-steps in a second of wall time, from when the stacks are put down."""
    steps = round(seconds / H)
    for threads in (1, 2):
        template, _ = world_of(scenes.stack(10))
        many = substep.RigidBatch(template, worlds, threads=threads)
        start = time.perf_counter()
        many.step(H, steps)
        rate = worlds * steps / (time.perf_counter() - start)
        emit("batch stack 10", "substep", "world_steps", rate, "1/s", threads)
        emit("batch stack 10", "substep", "world_seconds", rate * H, "1/s", threads)


# ---- precision -----------------------------------------------------------------------------


def on_incline(angle: float) -> substep.RigidBodies:
    """A box on a floor under gravity that leans by the angle, a second later."""
    gravity = (9.81 * math.sin(angle), 0.0, -9.81 * math.cos(angle))
    box = [("box", (0.5, 0.5, 0.25), (0, 0, 0.25), scenes.UPRIGHT, 1.0)]
    world, _ = world_of(box, gravity=gravity, friction=0.5)
    world.advance(1)
    return world


def slide(angle: float, seconds: float) -> tuple[float, float]:
    """How far the box slides, and by how much its speed changes."""
    world = on_incline(angle)
    x, v = world.positions[1, 0], world.velocities[1, 0]
    world.advance(seconds)
    return float(world.positions[1, 0] - x), float(world.velocities[1, 0] - v)


def incline() -> None:
    """The critical angle is that above which what slides becomes faster."""
    exact = math.atan(0.5)
    low, high = exact - 0.15, exact + 0.15
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (low, middle) if slide(middle, 4)[1] > 0 else (middle, high)
    emit("incline", "substep", "critical_angle", math.degrees(low), "deg", digits=6)
    emit("incline", "substep", "creep", abs(slide(0.8 * exact, 4)[0]), "m")
    steep = exact + 0.1
    a = 9.81 * (math.sin(steep) - 0.5 * math.cos(steep))
    emit("incline", "substep", "slide_error", abs(slide(steep, 1)[1] / a - 1), "1")


def bounce() -> None:
    """The worst of five heights, each against 0.64 of the one before."""
    ball = [("sphere", (0.5,), (0, 0, 5.5), scenes.UPRIGHT, 1.0)]
    world, _ = world_of(ball, restitution=0.8, friction=0.5)
    heights, top, v = [5.0], 0.0, 0.0
    while len(heights) < 6:
        z, before = float(world.positions[1, 2]) - 0.5, v
        v = float(world.velocities[1, 2])
        if before > 0 >= v:  # the top lies within the last step, on a parabola
            heights.append(top)
        top = z + v**2 / (2 * 9.81)
        world.step(H)
    emit_bounce("substep", heights)


def emit_bounce(peer: str, heights: list[float]) -> None:
    worst = max((abs(b / a / 0.64 - 1) for a, b in itertools.pairwise(heights)), default=1.0)
    emit("bounce", peer, "height_error", worst, "1")


def tumbling(rotation: str, seconds: float) -> None:
    world, _ = world_of([], gravity=(0, 0, 0), rotation=rotation)
    box = world.add(
        rigid.Box((1, 0.5, 0.2)), (0, 0, 100), angular_velocities=(0.01, 5.0, 0.0), mass=1.0
    )

    def energy() -> float:
        w, L = world.angular_velocities[box], world.angular_momenta[box]
        return 0.5 * float(w @ L)

    E, L, worst = energy(), world.angular_momenta[box].copy(), 0.0
    for _ in range(round(240 * seconds)):
        world.step(1 / 240)
        worst = max(worst, abs(energy() / E - 1))
    off = np.linalg.norm(world.angular_momenta[box] - L) / np.linalg.norm(L)
    emit("tumbling", f"substep {rotation}", "energy_error", worst, "1")
    emit("tumbling", f"substep {rotation}", "momentum_error", float(off), "1")


def cradle() -> None:
    balls = [("sphere", (0.5,), (k - (k == 0), 0, 2), scenes.UPRIGHT, 1.0) for k in range(5)]
    world, ids = world_of(balls, gravity=(0, 0, 0), restitution=1.0, friction=0.0)
    world.set_velocities([(1, 0, 0)], ids[:1])
    world.advance(3)
    emit_cradle("substep", world.velocities[ids, 0])


def emit_cradle(peer: str, v: Any) -> None:
    emit("cradle", peer, "last_ball", v[-1], "m/s")
    emit("cradle", peer, "other_balls", max(map(abs, v[:-1])), "m/s")


def dominoes() -> None:
    world, ids = world_of(scenes.dominoes())
    fell = np.full(len(ids), np.inf)
    for k in range(round(10 / H)):
        world.step(H)
        _, x, y, _ = world.rotations[ids].T
        down = 1 - 2 * (x**2 + y**2) < math.cos(math.radians(30))
        fell[down & np.isinf(fell)] = (k + 1) * H
    emit("dominoes", "substep", "fallen", np.isfinite(fell).sum(), "1")
    emit("dominoes", "substep", "wave_speed", 5 / (fell[20] - fell[10]), "m/s")


# ---- peers ---------------------------------------------------------------------------------


def of_standing(record: dict[str, Any], say: Callable[..., None]) -> None:
    say("step", record["value"], "ms")
    say("settled", record["ms_settled_last_s"], "ms")
    say("second", record["value"] / record["h"], "ms")
    say("late_overlap", record["max_penetration_last_quarter"], "m")
    if "pile" not in record["workload"]:
        say("drift", record["max_horizontal_drift"], "m")
        say("sinking", record["max_vertical_shift"], "m")
        say("fallen", record["fallen"], "1")


def of_incline(record: dict[str, Any], say: Callable[..., None]) -> None:
    say("critical_angle", record["value"], "deg", digits=6)
    say("creep", abs(record["creep_m_in_4s_at_0p8_crit"]), "m")
    say("slide_error", abs(record["slide_accel"] / record["slide_accel_exact"] - 1), "1")


def of_tumbling(record: dict[str, Any], say: Callable[..., None]) -> None:
    say("energy_error", record["max_energy_err"], "1")
    say("momentum_error", record["L_err_end"], "1")


def of_dominoes(record: dict[str, Any], say: Callable[..., None]) -> None:
    say("fallen", record["value"], "1")
    if record["wave_speed_m_s"]:
        say("wave_speed", record["wave_speed_m_s"], "m/s")


# (our name, theirs, what is read from it, peers with their options); each ends in minutes.
SCENES: list[tuple[str, str, Callable[..., None], dict[str, str]]] = [
    ("stack 10", "stack10", of_standing, {BULLET: "", BULLET_MAXC: "maxc=1", MUJOCO: ""}),
    ("stack 20", "stack20", of_standing, {BULLET: "", BULLET_MAXC: "maxc=1", MUJOCO: ""}),
    ("mass ratio 1000", "massratio1000", of_standing, {BULLET: "", MUJOCO: ""}),
    ("pyramid 210", "pyramid", of_standing, {BULLET: "", BULLET_MAXC: "maxc=1", MUJOCO: ""}),
    (
        "pile 1000 boxes",
        "pile_box",
        of_standing,
        {BULLET_MAXC: "maxc=1 T=3", MUJOCO + " CG 0.6 s": "solver=CG tol=1e-6 T=0.6"},
    ),
    ("pile 1000 mixed", "pile_mixed", of_standing, {BULLET_MAXC: "maxc=1 T=3"}),
    ("incline", "incline", of_incline, {BULLET: "", MUJOCO: ""}),
    (
        "tumbling",
        "dzhanibekov",
        of_tumbling,
        {BULLET: "T=100", MUJOCO: "T=100", MUJOCO + " RK4": "T=100 integ=RK4"},
    ),
    ("dominoes", "domino", of_dominoes, {BULLET: "", MUJOCO: ""}),
]


def output(*command: object) -> str:
    """What a program of the peers' Python prints; a failed one is left out."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        print(f"# {' '.join(map(str, command[1:]))} is left out: {done.stderr[-200:]!r}")
        return ""
    return done.stdout


def scene_record(python: str, peer: str, scene: str, options: str) -> dict[str, Any] | None:
    engine = "mujoco" if peer.startswith(MUJOCO) else "pybullet"
    folder = Path(os.environ.get("SUBSTEP_PEERS_SOLIDS", SOURCES))
    text = output(python, folder / "rigid_scenes.py", engine, scene, *options.split())
    lines = [line for line in text.splitlines() if line.startswith("{")]
    return json.loads(lines[0]) if lines else None


def peers(quick: bool) -> None:
    python = os.environ.get("SUBSTEP_PEER_PYTHON")
    if not python:
        print("# PyBullet and MuJoCo are left out: name their Python in SUBSTEP_PEER_PYTHON")
        return
    for name, scene, read, engines in SCENES:
        if quick and scene not in ("stack10", "massratio1000", "pyramid"):
            continue
        for peer, options in engines.items():
            record = scene_record(python, peer, scene, options + (" T=1" if quick else ""))
            if record:
                read(record, functools.partial(emit, name, peer))
    if not quick:
        peer_impacts(python)
    peer_sizes(python, quick)


def peer_impacts(python: str) -> None:
    """PyBullet only: MuJoCo has no coefficient of restitution."""
    record = scene_record(python, BULLET, "bounce", "")
    if record:
        emit_bounce(BULLET, [5.0, *record["peaks"]])
    record = scene_record(python, BULLET, "cradle", "")
    if record:
        emit_cradle(BULLET, record["all_v"])


def peer_sizes(python: str, quick: bool) -> None:
    script = HERE / "_rigid_peers.py"

    def result(*arguments: object) -> float | None:
        words = output(python, script, *arguments).split()
        return float(words[-1]) if words else None

    for count in (100,) if quick else (100, 300, 1000, 3000):
        for engine, peer in (("pybullet", BULLET_MAXC), ("mujoco", MUJOCO + " CG")):
            if engine == "mujoco" and count > 1000:
                continue
            value = result(engine, "growth", count, 0.25 if quick else 2)
            if value:
                emit(f"growth {count}", peer, "second", value, "ms")
    for threads in (1, 2):
        value = result("mujoco", "batch", 100 if quick else 1000, 60 if quick else 240, threads)
        if value:
            emit("batch stack 10", MUJOCO + " rollout", "world_steps", value, "1/s", threads)
            emit(
                "batch stack 10", MUJOCO + " rollout", "world_seconds", value / 240, "1/s", threads
            )
    value = result("pybullet", "batch", 20 if quick else 100, 60 if quick else 240, 1)
    if value:
        emit("batch stack 10", BULLET_MAXC + " loop", "world_steps", value, "1/s")
        emit("batch stack 10", BULLET_MAXC + " loop", "world_seconds", value / 240, "1/s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    standing(quick)
    piles(quick)
    growth([100, 1000] if quick else [100, 300, 1000, 3000, 10000, 30000], 0.25 if quick else 2)
    batch(100 if quick else 1000, 0.25 if quick else 1)
    incline()
    bounce()
    for rotation in ("splitting", "exact"):
        tumbling(rotation, 2 if quick else 100)
    cradle()
    dominoes()
    peers(quick)


if __name__ == "__main__":
    main()
