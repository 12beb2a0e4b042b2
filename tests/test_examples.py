"""Every example runs by itself, in an empty folder, and has something to show."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import substep

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
REQUIRED = ("matplotlib", "scipy", "vtk")


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example(example, tmp_path):
    source = example.read_text(encoding="utf-8")
    assert source.startswith('"""')
    assert source.count("\n") <= 40
    for module in re.findall(r"^(?:import|from) +(\w+)", source, re.MULTILINE):
        if module in REQUIRED and importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed")
    if "substep.sweep" in source:
        pytest.importorskip("distributed", reason="Dask is not installed")
    if "export.save(" in source:
        pytest.importorskip("pxr", reason="usd-core is not installed")
        pytest.importorskip("pysplashsurf", reason="pysplashsurf is not installed")
    if "substep.render import" in source:
        pytest.importorskip("pyvista", reason="PyVista is not installed")
    environment = os.environ | {
        "MPLBACKEND": "Agg",
        "PYTHONPATH": str(Path(substep.__file__).parents[1]),
        "PYTHONWARNINGS": "error::DeprecationWarning:__main__",
    }
    done = subprocess.run(
        [sys.executable, str(example)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    for picture in re.findall(r"\S+\.png", done.stdout):
        assert (tmp_path / picture).stat().st_size > 5000
    assert "Warning" not in done.stderr


def test_there_are_examples():
    assert len(EXAMPLES) >= 7
