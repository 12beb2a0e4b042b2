"""Robots from files beside MuJoCo: how they swing, stand and hold, and what is refused."""

import cProfile
import importlib.util
import math
import os
import pickle
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import substep
from substep import FormatError, InputError, RigidBodies, rigid

mujoco = pytest.importorskip("mujoco")


def packaged(package, *path):
    """A file that a package on the registry ships; nobody here made it."""
    found = importlib.util.find_spec(package)
    if found is None:
        pytest.skip(f"{package} is not installed")
    return str(Path(found.submodule_search_locations[0], *path))


def gym(name):
    return packaged("gymnasium", "envs", "mujoco", "assets", name)


def bullet(*path):
    return packaged("pybullet_data", *path)


def load(path, **options):
    return getattr(RigidBodies, "from_urdf" if path.endswith("urdf") else "from_mjcf")(
        path, **options
    )


def reference(path, springs, amplitude, free, gravity):
    """Names, starts and springs of the joints, and their coordinates in MuJoCo, 60 a second.

    By RK4 with 4000 steps a second, without contacts, limits, actuators and armature.
    """
    spec = mujoco.MjSpec.from_file(path)
    if path.endswith("urdf"):
        spec.compiler.fusestatic = False
    if free:
        next(iter(spec.worldbody.bodies)).add_freejoint()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what a package's file has of old
        m = spec.compile()
    off = mujoco.mjtDisableBit
    m.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_ACTUATION
    m.opt.integrator, m.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 1 / 3960
    m.opt.gravity = gravity
    m.dof_armature[:] = 0
    if m.ntendon:
        m.tendon_stiffness[:] = 0
    joints = [j for j in range(m.njnt) if int(m.jnt_type[j]) in (2, 3)]
    at, dofs = m.jnt_qposadr[joints], m.jnt_dofadr[joints]
    if springs is not None:
        m.jnt_stiffness[joints], m.dof_damping[dofs], m.qpos_spring[at] = springs, 0, m.qpos0[at]
    motors = [
        rigid.SpringMotor(0, m.jnt_stiffness[j], m.dof_damping[d])
        for j, d in zip(joints, dofs, strict=True)
    ]
    names = [mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_JOINT, j) for j in joints]
    d = mujoco.MjData(m)
    start = np.random.default_rng(1).uniform(-amplitude, amplitude, len(joints))
    d.qpos[at] = m.qpos0[at] + start
    rows = []
    for _ in range(120):
        mujoco.mj_step(m, d, nstep=66)
        rows.append(d.qpos[at] - m.qpos0[at])
    return dict(zip(names, start, strict=True)), motors, np.array(rows)


G = (0, 0, -9.81)
SWINGS = [  # file, free base, springs at the joints, largest error over the swing of each joint
    (lambda: gym("ant.xml"), False, 5.0, 0.014, 0.0009),
    (lambda: gym("half_cheetah.xml"), False, None, 0.028, 0.0018),
    (lambda: gym("humanoid.xml"), False, 20.0, 0.0105, 0.0008),
    (lambda: bullet("kuka_iiwa", "model.urdf"), False, None, 0.031, 0.008),
    (lambda: bullet("a1", "a1.urdf"), False, None, 0.00015, 0.00001),
    (lambda: bullet("a1", "a1.urdf"), True, 5.0, 0.046, 0.003),
    (lambda: bullet("laikago", "laikago_toes_zup.urdf"), False, None, 0.0004, 0.00003),
]


@pytest.mark.parametrize(("file", "free", "springs", "at_60", "at_240"), SWINGS)
def test_free_swing_is_that_of_mujoco(file, free, springs, at_60, at_240):
    path = file()
    start, motors, expected = reference(path, springs, 0.4, free, G)
    swing = np.ptp(expected, axis=0)
    for step, most in ((1 / 60, at_60), (1 / 240, at_240)):
        base = {"free_base": free} if path.endswith("urdf") else {}
        robot = load(path, coordinates=start, gravity=G, step=step, sleeping=False, **base)
        for i in range(len(robot)):
            for j in range(i):
                robot.exclude(i, j)
        joints = [robot.joint(name) for name in start]
        for joint, motor in zip(joints, motors, strict=True):
            joint.limits = None
            joint.motor = motor if motor.stiffness or motor.damping else None
        assert [joint.coordinate for joint in joints] == list(start.values())
        rows = []
        for _ in range(120):
            robot.advance(1 / 60)
            rows.append([joint.coordinate for joint in joints])
        off = (np.abs(np.array(rows) - expected).max(axis=0) / swing).max()
        assert off < most, f"{off} at {step}"


def drive(robot, targets, **motor):
    for name, target in targets.items():
        robot.joint(name).motor = rigid.SpringMotor(target, **motor)


def test_ant_stands_on_its_motors():
    pose = {f"ankle_{k}": sign * 0.9 for k, sign in ((1, 1), (2, -1), (3, -1), (4, 1))}
    pose |= {f"hip_{k}": 0.0 for k in (1, 2, 3, 4)}
    ant = RigidBodies.from_mjcf(gym("ant.xml"), coordinates=pose)
    assert set(ant.strengths.values()) == {150.0}
    drive(ant, pose, stiffness=60.0, damping=2.0, strength=150.0)
    torso = ant.body("torso")
    ant.advance(2.0)
    z = ant.positions[torso, 2]
    assert 0.3 < z < 0.75
    ant.advance(2.0)
    assert ant.positions[torso, 2] == pytest.approx(z, abs=2e-3)
    assert ant.rotations[torso, 0] > 0.999
    assert all(abs(ant.joint(name).coordinate - q) < 0.05 for name, q in pose.items())


def test_arm_goes_to_its_targets_and_holds():
    arm = RigidBodies.from_mjcf(gym("pusher_v5.xml"), gravity=G)
    names = [name for name in arm.joint_names if name.startswith("r_")]
    targets = dict(zip(names, (0.3, 0.4, -0.3, -0.7, 0.4, -0.3, 0.2), strict=True))
    assert len(targets) == 7
    drive(arm, targets, stiffness=400.0, damping=30.0)
    arm.advance(3.0)
    assert all(abs(arm.joint(name).coordinate - q) < 0.03 for name, q in targets.items())
    before = [arm.joint(name).coordinate for name in names]
    arm.advance(2.0)
    assert [arm.joint(name).coordinate for name in names] == pytest.approx(before, abs=1e-4)


def test_urdf_arm_holds():
    arm = RigidBodies.from_urdf(bullet("kuka_iiwa", "model.urdf"))
    assert set(arm.strengths.values()) == {300.0}
    (line,) = arm.ignored
    assert line.startswith("limits of the velocity of joints: lbr_iiwa_joint_1")
    assert arm.motions[arm.body("lbr_iiwa_link_0")] == "static"
    targets = dict(zip(arm.joint_names, (0.3, 0.6, -0.2, -1.2, 0.4, 0.7, 0.1), strict=True))
    drive(arm, targets, stiffness=2000.0, damping=150.0, strength=300.0)
    arm.advance(4.0)
    assert all(abs(arm.joint(name).coordinate - q) < 0.02 for name, q in targets.items())
    assert abs(arm.angular_velocities).max() < 1e-3


def test_urdf_quadruped_stands():
    feet = {"hip": 0.0, "upper": 0.8, "lower": -1.6}
    pose = {f"{leg}_{k}_joint": q for leg in ("FR", "FL", "RR", "RL") for k, q in feet.items()}
    dog = RigidBodies.from_urdf(bullet("a1", "a1.urdf"), free_base=True, coordinates=pose)
    assert dog.strengths["FR_upper_joint"] == 55.0
    (line,) = dog.ignored
    assert line.startswith("limits of the velocity of joints: FR_hip_joint")
    assert dog.body("imu_link") == dog.body("trunk")
    dog.set_positions(dog.positions + np.array((0, 0, 0.4)))
    dog.add(rigid.Plane(), (0, 0, 0), motion="static", friction=1.0)
    drive(dog, pose, stiffness=120.0, damping=4.0, strength=33.0)
    dog.advance(4.0)
    trunk = dog.body("trunk")
    assert 0.2 < dog.positions[trunk, 2] < 0.3 and dog.rotations[trunk, 0] > 0.99
    assert np.abs(dog.velocities[trunk]).max() < 1e-3


def test_humanoid_falls_and_comes_to_rest():
    robot = RigidBodies.from_mjcf(gym("humanoid.xml"))
    assert not any("limits of joints without" in line for line in robot.ignored)
    start = robot.diagnostics()["energy"]
    for _ in range(10):
        robot.advance(0.5)
        assert robot.diagnostics()["energy"] < start
        for name in robot.joint_names:
            joint = robot.joint(name)
            assert joint.limits[0] - 0.04 < joint.coordinate < joint.limits[1] + 0.04
    assert robot.diagnostics()["kinetic_energy"] < 0.1
    assert robot.report.joint_error < 1e-3


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
def test_limits_of_three_joints_of_a_body_without_dampers_stop_it_as_in_mujoco(tmp_path, step):
    """Soft limits that are hard and damped enough take the same of what meets them."""
    path = tmp_path / "gimbal.xml"
    ranges = {"x": (-20, 25), "z": (-15, 30), "y": (-30, 20)}
    joints = "".join(
        f'<joint name="{k}" axis="{k == "x":d} {k == "y":d} {k == "z":d}" range="{low} {high}"'
        ' solreflimit=".001 10" solimplimit=".99 .9999 .0001"/>'
        for k, (low, high) in ranges.items()
    )
    geom = '<geom type="box" pos=".2 .1 -.2" size=".2 .1 .05" mass="1"/>'
    option = '<option timestep="1e-4" integrator="implicitfast"/>'
    path.write_text(wrap(f"<body>{joints}{geom}</body>").replace("<world", option + "<world", 1))
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    robot = RigidBodies.from_mjcf(path, step=step, sleeping=False)
    assert not any("limits" in line for line in robot.ignored)
    start = robot.diagnostics()["energy"]
    met = set()

    def nearest(name, y):
        return min(abs(y - limit) for limit in robot.joint(name).limits)

    for frame in range(120):
        robot.advance(1 / 60)
        while d.time < (frame + 1) / 60 - 5e-5:
            mujoco.mj_step(m, d)
        q = [robot.joint(name).coordinate for name in ranges]
        assert q == pytest.approx(d.qpos, abs=3e-3)
        assert robot.diagnostics()["energy"] < start
        met |= {name for name, y in zip(ranges, q, strict=True) if nearest(name, y) < 1e-7}
    assert met == set(ranges)


SMALL = """<mujoco>
  <option gravity="0 0 -5"/>
  <default><geom friction="0.7 0.01 0.002"/></default>
  <asset><mesh name="roof" vertex="0 0 0  .2 0 0  0 .2 0  0 0 .2"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <geom type="box" size=".1 .2 .3" mass="3"/>
      <geom type="sphere" size=".5" contype="0" conaffinity="0" mass="0"/>
      <body name="tip" pos="0 0 .3"><geom type="mesh" mesh="roof" mass="1"/></body>
      <body name="leg" pos=".1 0 0">
        <joint name="hip" axis="0 1 0" range="-30 60" damping=".5" stiffness="2"/>
        <joint name="twist" axis="0 0 1" pos="0 0 .1" armature=".1"/>
        <geom type="capsule" size=".05 .2" pos="0 0 -.2" mass="1" condim="6"/>
        <body name="shin" pos="0 0 -.4">
          <joint name="knee" axis="0 1 0" damping=".25" ref="10"/>
          <geom type="cylinder" size=".04 .15" pos="0 0 -.15" mass=".5" condim="1"/>
        </body>
      </body>
      <body name="cart" pos="-.3 0 0">
        <joint name="rail" type="slide" axis="1 0 0" frictionloss="2"/>
        <geom type="ellipsoid" size=".1 .05 .05" mass=".5" contype="2" conaffinity="2"/>
        <body name="ball" pos="0 0 .3"><joint name="socket" type="ball" damping="1"/>
          <inertial pos="0 0 .1" mass=".2" diaginertia=".001 .001 .001"/></body>
      </body>
    </body>
    <body name="post" pos="3 0 0"><geom type="box" size=".1 .1 .5"/></body>
  </worldbody>
  <contact><exclude body1="base" body2="shin"/></contact>
  <actuator>
    <position name="servo" joint="knee" kp="40" kv="3" gear="2" forcerange="-9 9"/>
    <motor name="push" joint="rail" gear="5" ctrlrange="-2 2"/>
  </actuator>
  <sensor><jointpos joint="knee"/></sensor>
</mujoco>"""


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.xml"
    path.write_text(SMALL)
    return path


def test_what_a_file_becomes(small):
    robot = RigidBodies.from_mjcf(small, coordinates={"knee": 0.5})
    assert robot.body_names == ("world", "base", "tip", "leg", "shin", "cart", "ball", "post")
    assert robot.joint_names == ("hip", "twist", "knee", "rail", "socket")
    assert robot.gravity.tolist() == [0, 0, -5]
    assert robot.body("tip") == robot.body("base")
    assert robot.masses[robot.body("base")] == pytest.approx(4)
    assert robot.motions[[robot.body("world"), robot.body("post")]].tolist() == 2 * ["static"]
    hip, knee, rail = (robot.joint(name) for name in ("hip", "knee", "rail"))
    assert hip.limits == pytest.approx(np.deg2rad((-30, 60)))
    assert hip.motor == rigid.SpringMotor(0, 2, 0.5)
    # kp gear^2, kv gear^2 and the damping of the joint, the force over the gear.
    assert knee.motor.target == pytest.approx(0.5)
    assert knee.motor == rigid.SpringMotor(knee.motor.target, 160, 12.25, 18)
    assert knee.coordinate == 0.5
    assert rail.motor == rigid.SpeedMotor(0, 2)
    assert robot.strengths == {"hip": math.inf, "twist": math.inf, "knee": 18, "rail": 10}
    # A link stands between the two joints of the leg.
    assert hip.bodies[0] == robot.joint("twist").bodies[1]
    assert robot.masses[hip.bodies[0]] == pytest.approx(1e-5)
    leg, shin = (robot.fixtures(robot.body(name))[0] for name in ("leg", "shin"))
    assert (leg.friction, leg.spinning_friction, leg.rolling_friction) == (0.7, 0.01, 0.002)
    assert shin.friction == 0
    cart = robot.fixtures(robot.body("cart"))[0]
    assert cart.group & leg.mask == 0 and leg.group & cart.mask == 0
    assert robot.ignored == (
        "ellipsoids, which are hulls of 482 points: geom_6",
        "geometries that touch nothing: 1",
        "armature of joints: twist",
        "ref, from which coordinates of joints count: knee (0.174533)",
        "damping of free and ball joints: socket",
        "controls of actuators that give a force, of which strengths has: push",
        "sensors: 1",
    )


def test_poses_are_those_of_mujoco(small):
    start = {"hip": 0.4, "twist": -0.7, "knee": 0.5, "rail": 0.1}
    robot = RigidBodies.from_mjcf(small, coordinates=start)
    m = mujoco.MjModel.from_xml_path(str(small))
    d = mujoco.MjData(m)
    for name, q in start.items():
        d.joint(name).qpos += q
    mujoco.mj_forward(m, d)
    for name in ("base", "leg", "shin", "cart", "ball", "post"):
        row = robot.body(name)
        assert robot.positions[row] == pytest.approx(d.body(name).xpos, abs=1e-12)
        assert abs(robot.rotations[row] @ d.body(name).xquat) == pytest.approx(1, abs=1e-12)
    assert robot.masses[robot.ids != 0].min() > 0
    moving = np.isfinite(robot.masses)
    center = robot.masses[moving] @ robot.centers_of_mass[moving] / robot.masses[moving].sum()
    assert center == pytest.approx(d.subtree_com[1], abs=1e-4)
    robot.step()
    assert robot.report.joint_error < 1e-6
    assert robot.joint("hip").coordinate == pytest.approx(0.4, abs=0.05)


def test_names_go_where_the_world_goes(small):
    robot = RigidBodies.from_mjcf(small)
    for other in (robot.copy(), pickle.loads(pickle.dumps(robot))):
        assert other.body("shin") == robot.body("shin")
        assert other.joint("knee").motor == robot.joint("knee").motor
        assert other.ignored == robot.ignored
    plain = RigidBodies()
    assert plain.body_names == plain.joint_names == plain.ignored == ()


def test_keyframes_and_equalities(tmp_path):
    path = tmp_path / "loop.xml"
    path.write_text("""<mujoco><worldbody>
      <body name="a"><joint name="j" axis="0 1 0"/><geom size=".1" pos="1 0 0"/></body>
      <body name="b" pos="2 0 0"><joint name="k" axis="0 1 0"/><geom size=".1" pos="-1 0 0"/></body>
      </worldbody><equality><connect name="loop" body1="a" body2="b" anchor="1 0 0"/>
      <joint name="gear" joint1="j" joint2="k"/></equality>
      <actuator><position joint="j" kp="7"/></actuator>
      <keyframe><key name="low" qpos="0.25 0" ctrl="0.5"/></keyframe></mujoco>""")
    robot = RigidBodies.from_mjcf(path, keyframe="low")
    assert robot.joint("loop").kind == "ball" and robot.joint_names == ("j", "k", "loop")
    assert robot.joint("j").coordinate == 0.25
    assert robot.joint("j").motor == rigid.SpringMotor(0.5, 7)
    assert robot.ignored == ("equalities: gear",)


def test_contact_pairs_are_pairs_of_materials(tmp_path):
    path = tmp_path / "pairs.xml"
    path.write_text(
        """<mujoco><worldbody><geom name="floor" type="plane" size="9 9 1" friction="1"/>
        <body pos="0 0 .1"><freejoint/><geom name="sled" type="box" size=".3 .3 .1"/></body>
        <body pos="2 0 .1"><freejoint/><geom name="box" type="box" size=".3 .3 .1"/>
          <body pos="0 0 .5"><joint type="hinge"/><geom name="lid" type="box" size=".1 .1 .1"/>
          </body></body>
        <body pos="9 0 .1"><freejoint/><geom name="gone" type="sphere" size=".1" contype="0"
          conaffinity="0"/></body>
        </worldbody><contact>
          <pair geom1="sled" geom2="floor" friction=".2 .2 .01 .001 .001" condim="4"/>
          <pair name="hinged" geom1="box" geom2="lid"/><pair name="new" geom1="gone" geom2="floor"/>
          <pair name="skew" geom1="box" geom2="floor" friction=".2 .3 .01 .001 .001"/>
        </contact></mujoco>"""
    )
    world = RigidBodies.from_mjcf(path)
    assert any("hinged" in s and "new" in s and "skew" in s for s in world.ignored)
    assert world.material_pairs == {
        ("floor", "sled"): {
            "friction": 0.2,
            "spinning_friction": 0.01,
            "rolling_friction": 0.0,
        }
    }
    world.set_velocities((3, 0, 0), 1)
    world.advance(0.5)
    assert world.velocities[1, 0] == pytest.approx(3 - 0.2 * 9.81 * 0.5, rel=1e-3)


def test_what_does_not_move_by_itself(tmp_path):
    path = tmp_path / "still.xml"
    path.write_text("""<mujoco><worldbody>
      <body name="hand" mocap="true" pos="0 0 1"><geom size=".1"/>
        <body name="thumb" pos=".2 0 0"><geom size=".05"/></body></body>
      <body name="frame" pos="1 0 0"><body name="shelf" pos="1 0 0">
        <geom type="plane" size="1 1 1" pos="0 0 -.7"/>
        <body name="swing"><joint name="pin" axis="0 1 0"/><geom size=".1" pos=".5 0 0"/></body>
      </body></body></worldbody></mujoco>""")
    world = RigidBodies.from_mjcf(path)
    assert world.body_names == ("hand", "thumb", "shelf", "swing")
    assert world.motions.tolist() == ["kinematic", "static", "dynamic"]
    assert world.joint("pin").bodies == (world.body("swing"), world.body("shelf"))
    assert len(world.fixtures(world.body("thumb"))) == 2
    still = world.positions[:2].copy()
    world.advance(0.3)
    assert (world.positions[:2] == still).all() and world.joint("pin").coordinate > 0.5


def wrap(inside):
    return f"<mujoco><worldbody>{inside}</worldbody></mujoco>"


FIELD = (
    '<mujoco><asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1" elevation="0 1 1 0"/></asset>'
    '<worldbody><geom name="hill" type="hfield" hfield="h"/></worldbody></mujoco>'
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected an XML file of an element <mujoco>"),
        ("no XML", "expected an XML file of an element <mujoco>"),
        ("<robot/>", "expected an XML file of an element <mujoco>"),
        ("<mujoco><worldbody>", "XML"),
        (wrap("<geom type='torus'/>"), "torus"),
        (wrap("<body><freejoint/></body>"), "mass and inertia"),
        (wrap("<geom type='mesh' mesh='none'/>"), "mesh"),
        (FIELD, "geometry 'hill' is a height field, which is not supported"),
    ],
)
def test_files_that_are_refused(tmp_path, text, message):
    path = tmp_path / "wrong.xml"
    path.write_text(text)
    with pytest.raises(FormatError, match=message):
        RigidBodies.from_mjcf(path)


def test_arguments_that_are_refused(small, tmp_path):
    make = RigidBodies.from_mjcf
    for error, message, call in (
        (FileNotFoundError, "none.xml", lambda: make(tmp_path / "none.xml")),
        (IsADirectoryError, "directory", lambda: make(tmp_path)),
        (TypeError, "path: expected a file name", lambda: make(3)),
        (FormatError, "an element <robot>", lambda: RigidBodies.from_urdf(small)),
        (
            TypeError,
            "free_base: expected a bool",
            lambda: RigidBodies.from_urdf(small, free_base=1),
        ),
        (TypeError, "coordinates: expected a dict", lambda: make(small, coordinates=[1])),
        (
            InputError,
            "coordinates: expected one of",
            lambda: make(small, coordinates={"socket": 1}),
        ),
        (InputError, r"coordinates\['hip'\]", lambda: make(small, coordinates={"hip": math.nan})),
        (InputError, "keyframe: expected one of", lambda: make(small, keyframe="home")),
        (InputError, "step: expected a number above 0", lambda: make(small, step=0.0)),
    ):
        with pytest.raises(error, match=message):
            call()
    robot = make(small)
    with pytest.raises(InputError, match="name: expected one of world, base"):
        robot.body("trunk")
    with pytest.raises(InputError, match="name: expected one of hip"):
        robot.joint(0)
    robot.remove(robot.body("shin"))
    with pytest.raises(IndexError):
        robot.body("shin")
    with pytest.raises(IndexError, match="was removed"):
        robot.joint("knee")


def test_a_free_base_needs_one_root(tmp_path):
    path = tmp_path / "world.urdf"
    link = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" '
    link += 'iyz="0" izz="1"/></inertial></link>'
    joint = '<joint name="j{0}" type="continuous"><parent link="world"/><child link="{0}"/></joint>'
    links = '<link name="world"/>' + "".join(link.format(k) + joint.format(k) for k in "ab")
    path.write_text(f"<robot name='two'>{links}</robot>")
    assert RigidBodies.from_urdf(path).joint_names == ("ja", "jb")
    with pytest.raises(InputError, match="free_base: expected a file with one root link"):
        RigidBodies.from_urdf(path, free_base=True)


NUMBERS = """<mujoco><worldbody>
  <body name="arm" pos="0 0 {z}">
    <joint name="pin" axis="0 1 0" pos="{at} 0 0" damping="{damping}" range="-30 {range}"/>
    <geom name="rod" size=".1" pos=".5 0 0" friction="{friction} 0 0" mass="{mass}"/></body>
  </worldbody><actuator>
  <position name="servo" joint="pin" kp="{kp}" gear="{gear}" forcerange="-9 {force}"/></actuator>
  <keyframe><key name="low" qpos="{qpos}"/></keyframe></mujoco>"""
GOOD = dict(z=1, at=0, damping=1, range=30, friction=1, mass=1, kp=5, gear=1, force=9, qpos=0)


def load_quietly(path, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load(str(path), **options)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"z": "nan"}, "body 'arm': expected a finite place and a rotation, got .*nan"),
        ({"z": "inf"}, "body 'arm': expected a finite place and a rotation, got .*inf"),
        ({"at": "nan"}, "joint 'pin': expected a finite place and a rotation, got .*nan"),
        ({"damping": "-1"}, "joint 'pin': damping: expected a number of at least 0, got -1.0"),
        ({"range": "nan"}, r"joint 'pin': range: expected numbers, got \[-30.0, nan\]"),
        ({"friction": "-2"}, "geometry 'rod': friction: expected a number of at least 0, got -2.0"),
        ({"friction": "nan"}, "geometry 'rod': friction: expected a finite number, got nan"),
        ({"mass": "1e200"}, "body 'arm': mass: 1e\\+200 kg is out of range"),
        ({"mass": "1e308"}, "body 'arm': mass|inertia"),
        (
            {"kp": "1e200", "gear": "1e200"},
            "actuator 'servo': stiffness: .* finite number, got inf",
        ),
        ({"force": "nan"}, r"actuator 'servo': forcerange: expected numbers, got \[-9.0, nan\]"),
        ({"qpos": "inf"}, r"keyframe 'low': qpos\[0\]: expected finite numbers, got inf"),
    ],
)
def test_numbers_that_are_refused_are_named_with_file_and_element(
    tmp_path, monkeypatch, capfd, wrong, message
):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "odd.xml"
    path.write_text(NUMBERS.format(**GOOD))
    load_quietly(path, keyframe="low")
    path.write_text(NUMBERS.format(**{**GOOD, **wrong}))
    with pytest.raises(InputError, match=f"^{path}: {message}"):
        load_quietly(path, keyframe="low")
    assert os.listdir() == ["odd.xml"]  # and no MUJOCO_LOG.TXT
    assert capfd.readouterr() == ("", "")


def test_what_mujoco_warns_of_is_in_ignored_only(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    before = mujoco.get_mju_user_warning()
    (tmp_path / "odd.xml").write_text(NUMBERS.format(**{**GOOD, "kp": "nan"}))
    robot = load_quietly("odd.xml")
    assert any(line.startswith("what MuJoCo warns of: ") for line in robot.ignored)
    assert os.listdir() == ["odd.xml"] and capfd.readouterr() == ("", "")
    assert mujoco.get_mju_user_warning() is before


LIMITED = """<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="pin" type="{kind}"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
  <!-- <limit effort="-1"/> --><limit lower="{lower}" upper="{upper}" effort="{effort}"/></joint>
  </robot>"""


@pytest.mark.parametrize(
    ("kind", "lower", "upper", "effort", "message"),
    [
        ("revolute", 1, -1, 5, "lower, upper: expected the lower one first, got 1.0 and -1.0"),
        ("prismatic", 1, -1, 5, "lower, upper: expected the lower one first, got 1.0 and -1.0"),
        ("revolute", "nan", 1, 5, "lower, upper: expected the lower one first, got nan and 1.0"),
        ("revolute", -1, "nan", 5, "lower, upper: expected the lower one first, got -1.0 and nan"),
        ("revolute", -1, 1, -5, "effort: expected a number of at least 0, got -5.0"),
        ("continuous", -1, 1, "nan", "effort: expected a finite number, got nan"),
        ("continuous", 1, -1, 5, None),
        ("revolute", -1, 1, "inf", None),
    ],
)
def test_urdf_limits_that_are_none(tmp_path, kind, lower, upper, effort, message):
    path = tmp_path / "arm.urdf"
    path.write_text(LIMITED.format(kind=kind, lower=lower, upper=upper, effort=effort))
    if message is None:
        assert load_quietly(path).strengths == {"pin": float(effort)}
        return
    with pytest.raises(InputError, match=f"^{path}: joint 'pin': {message}$"):
        load_quietly(path)


def test_urdf_limits_that_leave_no_way_are_listed(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(LIMITED.format(kind="revolute", lower=0, upper=0, effort=5))
    (line,) = load_quietly(path).ignored
    assert line.startswith("what MuJoCo warns of: joint 'pin' has equal lower and upper limits")


def test_urdf_limits_of_velocity_are_listed(tmp_path):
    path = tmp_path / "arm.urdf"
    text = LIMITED.format(kind="revolute", lower=-1, upper=1, effort=5)
    path.write_text(text.replace('effort="5"/>', 'effort="5" velocity="3"/>'))
    assert load_quietly(path).ignored == ("limits of the velocity of joints: pin",)


def test_generated_names_leave_those_of_the_file(tmp_path):
    path = tmp_path / "names.xml"
    geom = '<geom size=".1" pos=".5 0 0"/>'
    path.write_text(
        wrap(
            f'<body><joint axis="0 1 0"/>{geom}</body>'
            f'<body name="body_1" pos="2 0 0"><joint name="joint_0" axis="0 1 0"/>{geom}</body>'
            f'<body name="Body_1" pos="4 0 0"><joint name="loop" axis="0 1 0"/>{geom}</body>'
        ).replace(
            "</mujoco>",
            '<equality><connect name="loop" body1="body_1" body2="Body_1" anchor="1 0 0"/>'
            "</equality></mujoco>",
        )
    )
    robot = RigidBodies.from_mjcf(path)
    assert robot.body_names == ("body_1_", "body_1", "Body_1")
    assert [robot.positions[robot.body(name), 0] for name in robot.body_names] == [0, 2, 4]
    assert robot.joint_names[:3] == ("joint_0_", "joint_0", "loop")
    hinged = [robot.joint(name).bodies[0] for name in robot.joint_names[:3]]
    assert hinged == [robot.body(name) for name in robot.body_names]


def test_as_many_bodies_take_as_much_time_each(tmp_path):
    """Counts calls of Python, which do not depend on the machine."""
    calls = []
    for n in (50, 100, 200):
        path = tmp_path / f"{n}.xml"
        joint = '<joint name="j{0}" axis="0 1 0" range="-30 30" damping="1"/>'
        body = f'<body name="b{{0}}" pos="{{0}} 0 1">{joint}<geom size=".1" pos=".5 0 0"/></body>'
        path.write_text(wrap("".join(body.format(k) for k in range(n))))
        profile = cProfile.Profile()
        robot = profile.runcall(RigidBodies.from_mjcf, path)
        assert len(robot) == len(robot.joints) == n
        calls.append(sum(entry.callcount for entry in profile.getstats()))
    per_body = (calls[2] - calls[1]) / 100
    assert per_body == pytest.approx((calls[1] - calls[0]) / 50, rel=0.02)
    assert per_body < 1300


def test_without_mujoco_the_extra_is_named(small, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r'pip install "substep\[robots\]"'):
        substep.RigidBodies.from_mjcf(small)
