"""The house itself: the build's messages and the checks of .ci."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def load_check(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / ".ci" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


needs_cmake = pytest.mark.skipif(
    not shutil.which("cmake") or not shutil.which("ninja"), reason="cmake or ninja not installed"
)


def configure(tmp_path, *options, **env):
    command = ["cmake", "-S", str(ROOT), "-B", str(tmp_path), "-G", "Ninja", *options]
    done = subprocess.run(
        command, env={**os.environ, **env}, capture_output=True, text=True, timeout=120
    )
    return done.returncode, [line.strip() for line in done.stderr.splitlines() if "missing" in line]


@needs_cmake
def test_missing_eigen_is_said_in_one_line(tmp_path):
    status, said = configure(tmp_path, "-DCMAKE_DISABLE_FIND_PACKAGE_Eigen3=ON")
    assert status != 0
    assert said == ["substep: missing Eigen 3.4 (Debian, Ubuntu: apt install libeigen3-dev)"]


@needs_cmake
def test_missing_compiler_and_eigen_are_said_in_one_line(tmp_path):
    status, said = configure(
        tmp_path,
        "-DCMAKE_DISABLE_FIND_PACKAGE_Eigen3=ON",
        CXX=str(tmp_path / "none"),
        CC=str(tmp_path / "none"),
    )
    assert status != 0
    assert said == [
        "substep: missing a C++20 compiler, Eigen 3.4 "
        "(Debian, Ubuntu: apt install g++ libeigen3-dev)"
    ]


def test_setup_without_root_names_the_line_to_type(tmp_path):
    # A PATH with nothing but what script/setup itself needs, and a user id that is not root's.
    for tool in ("bash", "dirname"):
        (tmp_path / tool).symlink_to(shutil.which(tool))
    (tmp_path / "python3").symlink_to(sys.executable)  # that of PATH may be a script
    (tmp_path / "id").write_text("#!/bin/sh\necho 1000\n")
    (tmp_path / "id").chmod(0o755)
    done = subprocess.run(
        [str(tmp_path / "bash"), str(ROOT / "script/setup"), "test"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    (line,) = [x for x in done.stderr.splitlines() if x.startswith("substep: missing")]
    assert "as root: apt-get install -y --no-install-recommends g++ cmake ninja-build" in line


def test_arrows_run_one_way():
    assert load_check("check_includes").wrong_includes(ROOT / "cpp") == []


@pytest.mark.parametrize(
    ("folder", "include", "complaint"),
    [
        ("core", '"substep/ode/stepping/system.h"', True),
        ("fields", '"substep/pbf/fluid.h"', True),
        ("linalg", '"substep/geometry/mesh.h"', True),
        ("fields", '"grid.h"', True),
        ("fields", "<pybind11/pybind11.h>", True),
        ("fields", '"substep/core/parallel.h"', False),
        ("pbf", '"substep/geometry/mesh.h"', False),
        ("fields", "<vector>", False),
        ("rigid/motion", '"substep/rigid/solver/joints.h"', True),
        ("rigid/solver", '"substep/rigid/motion/bodies.h"', False),
        ("rigid", '"substep/rigid/motion/bodies.h"', True),
        ("rigid/cloth", '"substep/core/parallel.h"', True),
        ("linalg", '"substep/linalg/direct/lu.h"', True),
        ("linalg/direct", '"substep/linalg/sparse.h"', False),
    ],
)
def test_wrong_arrows_are_found(tmp_path, folder, include, complaint):
    path = tmp_path / "substep" / folder / "x.h"
    path.parent.mkdir(parents=True)
    path.write_text(f"#pragma once\n#include {include}\n")
    assert bool(load_check("check_includes").wrong_includes(tmp_path)) == complaint


def test_circles_of_headers_are_found(tmp_path):
    for name, other in (("x", "y"), ("y", "x")):
        path = tmp_path / f"substep/core/{name}.h"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f'#include "substep/core/{other}.h"\n')
    (line,) = load_check("check_includes").wrong_includes(tmp_path)
    assert line.startswith("a circle of headers: substep/core/")


def test_stubs_have_the_types_that_we_pass():
    pytest.importorskip("pybind11_stubgen", reason="pybind11-stubgen is a tool of .ci/run")
    printed = """
__all__: list[str] = ['A']
class A:
    '''What it is.'''
    def f(self, x: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None, n:
          typing.SupportsInt | typing.SupportsIndex = 3, other: A = None) -> dict:
        '''What it does.'''
    @property
    def sizes(self) -> typing.Annotated[list[float], "FixedSize(3)"]: ...
level: str = 'v4'
"""
    expected = """class A:
    def f(
        self, x: numpy.typing.ArrayLike | None, n: int = 3, other: A | None = None
    ) -> dict[str, typing.Any]: ...
    @property
    def sizes(self) -> list[float]: ...

level: str
"""
    module = load_check("generate_stubs")
    assert module.stub_of(printed) == module.HEAD + expected


def test_the_tree_in_the_docs_is_what_the_command_prints():
    house = load_check("print_house")
    assert house.MARKS[0] + house.tree() + house.MARKS[1] in house.PAGE.read_text()


@pytest.mark.parametrize(
    ("file", "line", "broken"),
    [
        ("errors.py", "", None),
        ("base/checks.py", "def f():\n    from ..recording import Recording\n", "one way"),
        ("pbd/rest.py", "from ..pbf import fluid\n", "one way"),
        ("springs/soft_body.py", "def f():\n    import substep.cli\n", "one way"),
        ("view/look.py", "if TYPE_CHECKING:\n    from .view import View\n", "no circles"),
    ],
)
def test_wrong_imports_are_found(tmp_path, file, line, broken):
    pytest.importorskip("importlinter", reason="import-linter is a tool of .ci/run")
    source = ROOT / "python/substep"
    for path in source.rglob("*.py"):
        copied = tmp_path / "substep" / path.relative_to(source)
        copied.parent.mkdir(parents=True, exist_ok=True)
        copied.write_text(path.read_text())
    with open(tmp_path / "substep" / file, "a") as changed:
        changed.write(line)
    code = "import importlinter.cli; importlinter.cli.lint_imports_command()"
    done = subprocess.run(
        [sys.executable, "-c", code, "--no-cache", "--config", str(ROOT / "pyproject.toml")],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode == 0) == (broken is None), done.stdout + done.stderr
    assert broken is None or f"{broken} BROKEN" in done.stdout
