import importlib
import inspect
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import substep
from substep.base import native


def run_python(code, **env):
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **env},
        capture_output=True,
        text=True,
        timeout=60,
    )


def installed_levels():
    folder = os.path.join(os.path.dirname(substep.__file__), "_isa")
    return sorted(os.listdir(folder))


def test_show_config_prints_what_it_returns(capsys):
    entries = substep.show_config()
    printed = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert printed == entries
    assert entries["substep"] == substep.__version__
    project = Path(__file__).parents[1] / "pyproject.toml"
    assert f'\nversion = "{substep.__version__}"\n' in project.read_text()
    changes = (project.parent / "docs/changelog.md").read_text()
    assert changes.split("\n## ")[1].startswith(f"{substep.__version__}\n")
    assert entries["level"] in native.LEVELS
    assert entries["threads"] == str(substep.num_threads())
    assert entries["numpy"] == np.__version__
    versions = substep._core.library_versions()
    assert entries["suitesparse"].startswith(versions["suitesparse"])
    assert versions["blas"] in entries["blas"]


def test_every_installed_level_can_be_chosen():
    usable = native.LEVELS.index(substep._cpu.level())
    for level in installed_levels():
        done = run_python("import substep; print(substep._core.level)", SUBSTEP_ISA=level)
        if native.LEVELS.index(level) <= usable:
            assert done.stdout.strip() == level, done.stderr
        else:
            assert done.returncode != 0 and "ImportError" in done.stderr


@pytest.mark.parametrize("wrong", ["v9", "V2", "../v2", " "])
def test_wrong_level_is_refused_and_the_offer_named(wrong):
    done = run_python("import substep; substep.num_threads()", SUBSTEP_ISA=wrong)
    assert done.returncode == 1
    message = done.stderr.strip().splitlines()[-1]
    assert message.startswith(f"ImportError: SUBSTEP_ISA={wrong}")
    assert any(level in message for level in installed_levels())


def test_one_level_per_process():
    code = """
import os, sys
import substep
first = substep._core.level
del substep
for name in [n for n in sys.modules if n.startswith("substep")]:
    del sys.modules[name]
import substep
from substep import _cpu
assert _cpu.claim("v2") == _cpu.claim("v3") == first
os.environ["SUBSTEP_ISA"] = "v2" if first != "v2" else "v3"
try:
    substep._core
except ImportError as error:
    print(error)
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert "SUBSTEP_ISA=v" in done.stdout


def test_loading_twice_gives_the_same_module():
    assert native.load() is substep._core is native.load()


def test_the_first_use_may_be_in_several_threads_at_once():
    code = """
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import substep

sys.setswitchinterval(1e-6)
together = Barrier(4)


def first_use(k):
    together.wait()
    if k % 2:
        return substep.advect(substep.DoubleGyre(), [[0.1, 0.2]], (0, 0.1), step=0.05).final.size
    return substep.solve_ivp(substep.systems.Lorenz(), (0, 1), [1.0, 1.0, 1.0]).y[:, -1].size


with ThreadPoolExecutor(4) as pool:
    print(list(pool.map(first_use, range(4))))
"""
    done = run_python(code)
    assert done.stdout == "[3, 2, 3, 2]\n", done.stderr


def test_an_interrupt_of_the_first_use_breaks_nothing():
    code = """
import signal, threading
import substep

known = threading.main_thread


def main_thread():  # which the core asks for while it is loaded
    threading.main_thread = known
    signal.raise_signal(signal.SIGINT)
    return known()


threading.main_thread = main_thread
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    substep._core
except BaseException as error:
    print(type(error).__name__)
bodies = substep.RigidBodies()
bodies.step()
print(bodies.report.steps)
"""
    done = run_python(code)
    assert done.stdout.split() == ["KeyboardInterrupt", "1"], done.stderr


def test_import_is_lazy_and_quick():
    code = "import sys, substep; print([m for m in ('numpy', 'h5py', 'scipy') if m in sys.modules])"
    assert run_python(code).stdout.strip() == "[]"


def test_unknown_names_and_dir():
    with pytest.raises(AttributeError, match="no attribute 'solve_pvi'"):
        substep.solve_pvi  # noqa: B018
    assert set(dir(substep)) == {*substep.__all__, "__version__"}


def test_public_modules_show_their_public_names():
    found = pkgutil.walk_packages(substep.__path__, "substep.")
    modules = [importlib.import_module(m.name) for m in found if m.name != "substep.__main__"]
    public = [module for module in modules if hasattr(module, "__all__")]
    shown = {value for name in substep.__all__ if inspect.ismodule(value := getattr(substep, name))}
    assert len(shown) > 15 and shown <= set(public)
    for module in public:
        assert dir(module) == sorted(module.__all__), module
        for name in module.__all__:
            assert getattr(module, name) is not None and not name.startswith("_")


def test_state_hash_sees_every_bit():
    x = np.arange(6.0).reshape(2, 3)
    same = substep.state_hash(x)
    assert same == substep.state_hash(x.copy()) == substep.state_hash(np.asfortranarray(x))
    assert len(same) == 32
    y = x.copy()
    y[1, 2] = np.nextafter(y[1, 2], 9)
    variants = [y, x.T, x.reshape(3, 2), x.astype(np.float32), x.ravel(), -x, x[:1]]
    hashes = {same, *(substep.state_hash(v) for v in variants), substep.state_hash(x, x)}
    assert len(hashes) == len(variants) + 2
    assert substep.state_hash(0.0) != substep.state_hash(-0.0)
    assert substep.state_hash(np.empty((0, 3))) != substep.state_hash(np.empty((3, 0)))
    assert substep.state_hash([x[:1], x[1:]]) != substep.state_hash(x[:1], x[1:])


def test_state_hash_refuses_what_has_no_bits_of_its_own():
    with pytest.raises(TypeError, match="object"):
        substep.state_hash(np.array([None, {}]))


@pytest.mark.parametrize("wrong", [0, -1, 1025, 1.5, True, "2", None, 2**70, np.float64(2)])
def test_set_num_threads_refuses(wrong):
    before = substep.num_threads()
    with pytest.raises(substep.InputError, match="threads"):
        substep.set_num_threads(wrong)
    assert substep.num_threads() == before


def test_set_num_threads():
    before = substep.num_threads()
    try:
        for threads in (1, 3, np.int64(2)):
            substep.set_num_threads(threads)
            assert substep.num_threads() == threads
    finally:
        substep.set_num_threads(before)


def test_threads_from_the_environment():
    code = "import substep; print(substep.num_threads())"
    assert run_python(code, SUBSTEP_NUM_THREADS="3").stdout.strip() == "3"
    assert int(run_python(code, SUBSTEP_NUM_THREADS="").stdout) >= 1
    affinity = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); " + code
    assert run_python(affinity, SUBSTEP_NUM_THREADS="").stdout.strip() == "1"


@pytest.mark.parametrize("wrong", ["0", "-2", "two", "2.5", "4 threads", "1025", "9" * 30])
def test_wrong_threads_in_the_environment_are_refused(wrong):
    done = run_python("import substep; substep.num_threads()", SUBSTEP_NUM_THREADS=wrong)
    assert done.returncode == 1
    assert done.stderr.strip().splitlines()[-1] == (
        "substep.errors.InputError: SUBSTEP_NUM_THREADS: "
        f"expected an integer from 1 to 1024, got {wrong}"
    )


def test_exception_tree():
    tree = {
        "InputError": (substep.SubstepError, ValueError),
        "SolverError": (substep.SubstepError, RuntimeError),
        "NonFiniteError": (substep.SolverError,),
        "ConvergenceError": (substep.SolverError,),
        "SingularMatrixError": (substep.SolverError,),
        "FormatError": (substep.SubstepError, ValueError),
        "TruncatedError": (substep.FormatError,),
        "CorruptError": (substep.FormatError,),
        "VersionError": (substep.FormatError,),
    }
    for name, parents in tree.items():
        assert getattr(substep, name).__bases__ == parents
    error = substep.NonFiniteError("x", time=1.5, index=2, step=3, result="part")
    assert (error.time, error.index, error.step, error.result) == (1.5, 2, 3, "part")


NEEDED = {  # by extra: the module that it brings, and what cannot be done without it
    "plot": ("matplotlib", "substep.stability.plot('rk4')"),
    "view": ("viser", "substep.show(bodies, open_browser=False, wait=False)"),
    "viz": ("pyvista", "substep.render.save_picture('run.vtkhdf', 'a.png')"),
    "surface": ("pysplashsurf", "substep.geometry.liquid_surface([[0.0, 0, 0]], 0.1)"),
    "mesh": ("meshio", "substep.export.save('run.vtkhdf', 'a.vtu')"),
    "robots": ("mujoco", "substep.RigidBodies.from_mjcf('robot.xml')"),
    "decomposition": (
        "coacd",
        "substep.geometry.convex_decomposition(substep.Box((1, 1, 1)).mesh())",
    ),
    "usd": ("pxr", "substep.export.save('run.vtkhdf', 'a.usdc')"),
    "gltf": ("pygltflib", "substep.export.save('run.vtkhdf', 'a.glb')"),
    "blender": ("bpy", "substep.export.save('run.vtkhdf', 'a.abc')"),
    "sweep": ("distributed", "substep.sweep(dict, {'k': [1]}, 'sweep')"),
}


def test_every_extra_is_tried():
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text()
    extras = text.partition("[project.optional-dependencies]")[2].partition("\n[")[0]
    names = {line.split(" = ")[0] for line in extras.splitlines() if " = " in line[:20]}
    assert names - {"all", "docs", "test"} == set(NEEDED)


@pytest.mark.parametrize("extra", NEEDED)
def test_an_extra_that_is_missing_is_named_with_its_line(extra, tmp_path, monkeypatch):
    module, call = NEEDED[extra]
    bodies = substep.RigidBodies()
    bodies.add(substep.Box((1, 1, 1)), (0, 0, 1))
    parts = {"cloth": substep.Part("mesh", triangles=[[0, 1, 2]])}
    with substep.Recorder(tmp_path / "run.vtkhdf", parts=parts) as recorder:
        recorder.append(0.0, {"cloth": {"points": np.eye(3)}})
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    monkeypatch.chdir(tmp_path)
    for name in [module, *(name for name in sys.modules if name.startswith(f"{module}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError) as raised:
        eval(call, {"substep": substep, "bodies": bodies})
    assert f'pip install "substep[{extra}]"' in str(raised.value)
