"""Piles of any size and many worlds at once in PyBullet and MuJoCo, for bench/rigid.py.

ENGINE growth COUNT SECONDS: prints the time of a simulated second [ms].
ENGINE batch WORLDS STEPS THREADS: worlds of a stack of ten boxes; prints world-steps per second.
Steps of 1/240 s, which both need; PyBullet in maximal coordinates, its fastest form.
"""

import sys
import time

import _rigid_scenes as scenes
import numpy as np

H = 1 / 240


def mujoco_model(bodies, walls=(), options=""):
    import mujoco

    geoms = ['<geom type="plane" size="50 50 1"/>']
    for half, at in walls:
        geoms.append(f'<geom type="box" size="{numbers(half)}" pos="{numbers(at)}"/>')
    for kind, size, at, q, mass in bodies:
        geoms.append(
            f'<body pos="{numbers(at)}" quat="{numbers(q)}"><freejoint/>'
            f'<geom type="{kind}" size="{numbers(size)}" mass="{mass}"/></body>'
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{H}" {options}/><size memory="1G"/>'
        '<default><geom friction="0.5 0 0" condim="3"/></default>'
        f"<worldbody>{''.join(geoms)}</worldbody></mujoco>"
    )


def numbers(values):
    return " ".join(map(str, values))


def bullet_world(bodies, walls=()):
    import pybullet as p

    client = p.connect(p.DIRECT)
    here = {"physicsClientId": client}
    p.setGravity(0, 0, -9.81, **here)
    p.setTimeStep(H, **here)
    p.setPhysicsEngineParameter(deterministicOverlappingPairs=1, **here)
    shapes = {}

    def shape(kind, size):
        if (kind, size) not in shapes:
            if kind == "box":
                made = p.createCollisionShape(p.GEOM_BOX, halfExtents=size, **here)
            elif kind == "sphere":
                made = p.createCollisionShape(p.GEOM_SPHERE, radius=size[0], **here)
            else:
                made = p.createCollisionShape(
                    p.GEOM_CAPSULE, radius=size[0], height=2 * size[1], **here
                )
            shapes[kind, size] = made
        return shapes[kind, size]

    ids = [
        p.createMultiBody(0, shape("box", half), basePosition=at, **here)
        for half, at in [((50, 50, 1), (0, 0, -1)), *walls]
    ]
    for kind, size, at, q, mass in bodies:
        ids.append(
            p.createMultiBody(
                mass,
                shape(kind, size),
                basePosition=at,
                baseOrientation=(*q[1:], q[0]),
                useMaximalCoordinates=1,
                **here,
            )
        )
    for body in ids:
        p.changeDynamics(
            body,
            -1,
            lateralFriction=0.5**0.5,
            linearDamping=0,
            angularDamping=0,
            activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
            **here,
        )
    return lambda: p.stepSimulation(**here)


def growth(engine, count, seconds):
    bodies, walls = scenes.pile(count, ["box"])
    if engine == "mujoco":
        import mujoco

        model = mujoco_model(bodies, walls, 'solver="CG" tolerance="1e-6"')
        data = mujoco.MjData(model)

        def step():
            mujoco.mj_step(model, data)
    else:
        step = bullet_world(bodies, walls)
    start = time.perf_counter()
    for _ in range(round(seconds / H)):
        step()
    return 1e3 * (time.perf_counter() - start) / seconds


def batch(engine, worlds, steps, threads):
    bodies = scenes.stack(10)
    if engine == "mujoco":
        import mujoco
        from mujoco import rollout

        model = mujoco_model(bodies)
        data = [mujoco.MjData(model) for _ in range(threads)]
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        first = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data[0], first, kind)
        states = np.tile(first, (worlds, 1))
        start = time.perf_counter()
        rollout.rollout(model, data, states, nstep=steps)
    else:
        stepped = [bullet_world(bodies) for _ in range(worlds)]
        start = time.perf_counter()
        for _ in range(steps):
            for step in stepped:
                step()
    return worlds * steps / (time.perf_counter() - start)


if __name__ == "__main__":
    engine, what, *values = sys.argv[1:]
    if what == "growth":
        print("result", growth(engine, int(values[0]), float(values[1])))
    else:
        print("result", batch(engine, *map(int, values)))
