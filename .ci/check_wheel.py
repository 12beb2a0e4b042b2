"""Exercises an installed substep that has its required dependencies only."""

import importlib.metadata
import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parents[1]


def run(*args: str, cwd: str) -> str:
    """Output of a command that must succeed."""
    return subprocess.run(args, cwd=cwd, check=True, capture_output=True, text=True).stdout


def import_seconds(cwd: str) -> float:
    """Best of five: what `import substep` adds to starting Python."""
    code = "import time; t = time.perf_counter(); import substep; print(time.perf_counter() - t)"
    return min(float(run(sys.executable, "-c", code, cwd=cwd)) for _ in range(5))


with tempfile.TemporaryDirectory() as folder:
    import substep

    assert HERE not in Path(substep.__file__).parents or "site-packages" in substep.__file__
    for extra in ("matplotlib", "pysplashsurf", "scipy", "vtk"):
        assert importlib.util.find_spec(extra) is None, f"{extra} must not be needed"
    config = substep.show_config()
    assert config["suitesparse"].endswith("with supernodal CHOLMOD and UMFPACK"), config
    versions = substep._core.library_versions()
    assert versions["blas_is_serial"] and versions["blas_is_reentrant"], versions
    libraries = {
        line.split()[-1]
        for line in Path("/proc/self/maps").read_text().splitlines()
        if any(name in line for name in ("libblas", "liblapack", "libopenblas", "libcholmod"))
    }
    ours = Path(substep.__file__).parents[1] / "substep.libs"
    assert len(libraries) == 2, libraries  # no second BLAS, and LAPACK only in OpenBLAS
    assert all(Path(library).parent == ours for library in libraries), libraries
    licences = importlib.metadata.files("substep") or []
    assert any(str(path).endswith("licenses/SuiteSparse.txt") for path in licences), licences
    seconds = import_seconds(folder)
    print(f"import substep: {seconds * 1e3:.1f} ms")
    assert seconds < 0.15
    for level in ("v2", "v3"):
        code = "import substep; print(substep._core.level)"
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=folder,
            check=True,
            capture_output=True,
            env={"SUBSTEP_ISA": level},
        )
        assert done.stdout.decode().strip() == level
    command = str(Path(sys.executable).parent / "substep")
    run(command, "run", "double-gyre", "--frames", "5", "--out", "run", cwd=folder)
    recordings = [p for p in Path(folder, "run").rglob("*") if p.suffix == ".vtkhdf"]
    assert recordings, f"no recording in {sorted(Path(folder, 'run').rglob('*'))}"
    print(run(command, "info", str(recordings[0]), cwd=folder))
    picture = subprocess.run(
        [command, "render", str(recordings[0])], cwd=folder, capture_output=True, text=True
    )
    assert picture.returncode == 1 and "substep[plot]" in picture.stderr, picture
