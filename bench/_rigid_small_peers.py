"""Small worlds in PyBullet and MuJoCo, for bench/rigid_small.py: ENGINE SCENE SECONDS.

ENGINE: mujoco, mujoco-rk4 (Runge and Kutta's method, steps half as long), pybullet. Prints one JSON
line: the mean time of a step [us], its size [s], the deepest contact at the end [m] and, where
nothing touches, the largest change of the energy in 3 s, 60 times a second [J]. Joints of all are
coordinates: they cannot come apart.
"""

import json
import sys
import time

import _rigid_scenes as scenes
import numpy as np
from _rigid_peers import H, numbers


def mujoco_tree(parts):
    children = {}
    for k, part in enumerate(parts):
        children.setdefault(-1 if part[0] is None else part[0], []).append(k)

    def body(k, origin):
        _, joint, anchor, axis, ends, radius, mass = parts[k]
        own = np.asarray(anchor, float) if joint else ends.mean(axis=0)
        free = {"ball": '<joint type="ball"/>', None: "<freejoint/>"}
        kind = free.get(joint, f'<joint type="hinge" axis="{numbers(axis)}"/>')
        fromto = numbers((ends - own).ravel())
        inner = "".join(body(j, own) for j in children.get(k, ()))
        return (
            f'<body pos="{numbers(own - origin)}">{kind}<geom type="capsule" fromto="{fromto}" '
            f'size="{radius}" mass="{mass}"/>{inner}</body>'
        )

    return "".join(body(k, np.zeros(3)) for k in children[-1])


def mujoco_world(boxes, trees, floor, options=f'timestep="{H}"'):
    import mujoco

    geoms = ['<geom type="plane" size="50 50 1"/>'] if floor else []
    for _, size, at, q, mass in boxes:
        geoms.append(
            f'<body pos="{numbers(at)}" quat="{numbers(q)}"><freejoint/>'
            f'<geom type="box" size="{numbers(size)}" mass="{mass}"/></body>'
        )
    touching = "" if floor else 'contype="0" conaffinity="0"'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option {options}><flag energy="enable"/></option><size memory="1G"/>'
        f'<default><geom friction="0.5 0 0" condim="3" {touching}/></default>'
        f"<worldbody>{''.join(geoms + [mujoco_tree(tree) for tree in trees])}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)

    def energy():
        mujoco.mj_forward(model, data)
        unstable = any(warning.number for warning in data.warning)  # it begins anew then
        return float("inf") if unstable else float(data.energy.sum())

    def depth():
        return max([0.0, *(-contact.dist for contact in data.contact[: data.ncon])])

    return lambda: mujoco.mj_step(model, data), energy, depth


def bullet_tree(p, parts, floor):
    """A multi-body: frames of links are at their joints, along the axes of the world."""

    def capsule(ends, radius, origin):
        along = ends[1] - ends[0]
        q = scenes.turn_to(along)[[1, 2, 3, 0]].tolist()
        place = (ends.mean(axis=0) - origin).tolist()
        height = float(np.linalg.norm(along))
        placed = {"collisionFramePosition": place, "collisionFrameOrientation": q}
        shape = p.createCollisionShape(p.GEOM_CAPSULE, radius=radius, height=height, **placed)
        return shape, place, q

    rooted = parts[0][0] is None
    root = parts[0][4].mean(axis=0) if rooted else np.zeros(3)
    frames = {0: root} if rooted else {-1: root}
    given = [[] for _ in range(10)]
    for k, (parent, joint, anchor, axis, ends, radius, mass) in enumerate(parts):
        if joint is None:
            continue
        frames[k] = np.asarray(anchor, float)
        shape, place, q = capsule(ends, radius, frames[k])
        kind = p.JOINT_SPHERICAL if joint == "ball" else p.JOINT_REVOLUTE
        above = parent if rooted else parent + 1  # of links, from 1; 0 is the base
        pose = (frames[k] - frames[parent]).tolist(), [0, 0, 0, 1]
        for values, value in zip(
            given, (mass, shape, -1, *pose, place, q, above, kind, axis), strict=True
        ):
            values.append(value)
    base = (parts[0][6], capsule(parts[0][4], parts[0][5], root)[0]) if rooted else (0, -1)
    body = p.createMultiBody(
        *base, -1, root.tolist(), [0, 0, 0, 1], [0, 0, 0], [0, 0, 0, 1], *given
    )
    for link, kind in enumerate(given[8]):
        p.changeDynamics(body, link, jointDamping=0)
        if kind == p.JOINT_REVOLUTE:
            p.setJointMotorControl2(body, link, p.VELOCITY_CONTROL, force=0)
        else:
            still = {"targetPosition": [0, 0, 0, 1], "positionGain": 0, "velocityGain": 0}
            p.setJointMotorControlMultiDof(body, link, p.POSITION_CONTROL, force=[0, 0, 0], **still)
        if not floor:
            p.setCollisionFilterGroupMask(body, link, 0, 0)
    return body


def bullet_world(boxes, trees, floor):
    import pybullet as p

    p.connect(p.DIRECT)
    p.setGravity(0, 0, -9.81)
    p.setTimeStep(H)
    p.setPhysicsEngineParameter(deterministicOverlappingPairs=1)
    bodies = [p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))] if floor else []
    for _, size, at, _, mass in boxes:
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=size)
        bodies.append(p.createMultiBody(mass, shape, basePosition=at, useMaximalCoordinates=1))
    bodies += [bullet_tree(p, tree, floor) for tree in trees]
    awake = {"activationState": p.ACTIVATION_STATE_DISABLE_SLEEPING}
    for body in bodies:
        for link in range(-1, p.getNumJoints(body)):
            p.changeDynamics(
                *(body, link), lateralFriction=0.5**0.5, linearDamping=0, angularDamping=0, **awake
            )

    def energy():
        """Of links only; nan where bodies have none."""
        total = 0.0
        for body in bodies:
            for link in range(p.getNumJoints(body)):
                mass, _, inertia = p.getDynamicsInfo(body, link)[:3]
                x, q, *_, v, w = p.getLinkState(body, link, computeLinkVelocity=1)[:8]
                turn = np.array(p.getMatrixFromQuaternion(q)).reshape(3, 3)
                spin = turn.T @ w
                total += 0.5 * mass * np.dot(v, v) + mass * 9.81 * x[2]
                total += 0.5 * float(spin @ (np.array(inertia) * spin))
        return float(total) if trees and not floor else float("nan")

    def depth():
        return max([0.0, *(-contact[8] for contact in p.getContactPoints())])

    return p.stepSimulation, energy, depth


def rk4_world(boxes, trees, floor):
    return mujoco_world(boxes, trees, floor, f'timestep="{H / 2}" integrator="RK4"')


def main(engine, scene, seconds):
    h = H / 2 if engine == "mujoco-rk4" else H
    make = {"mujoco": mujoco_world, "mujoco-rk4": rk4_world, "pybullet": bullet_world}[engine]
    step, energy, depth = make(*scenes.SMALL[scene])
    steps = round(float(seconds) / h)
    step()
    before = time.perf_counter()
    for _ in range(steps - 1):
        step()
    mean = 1e6 * (time.perf_counter() - before) / (steps - 1)
    record = {"step": mean, "h": h, "depth": depth()}
    if not scenes.SMALL[scene][2]:
        step, energy, _ = make(*scenes.SMALL[scene])
        start, frame = energy(), round(1 / 60 / h)
        change = 0.0
        for _ in range(min(steps // frame, 180)):
            for _ in range(frame):
                step()
            change = max(change, abs(energy() - start))
        record["energy_change"] = change
    print(json.dumps(record))


if __name__ == "__main__":
    main(*sys.argv[1:])
