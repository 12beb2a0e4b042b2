"""The documentation holds: links lead somewhere, and every python block runs."""

import importlib.util
import re
from pathlib import Path

import pytest
import substep

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
WITH_CODE = [page for page in PAGES if "```python" in page.read_text(encoding="utf-8")]
OPTIONAL = ("matplotlib", "numba", "scipy", "vtk")

FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```\s*$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\[\]]*\])*\]\(([^()\s]+)\)")


def name(page):
    return str(page.relative_to(ROOT))


def prose(page):
    """The text without its code."""
    return re.sub(r"`[^`\n]+`", "", FENCE.sub("", page.read_text(encoding="utf-8")))


def anchors(page):
    """Names of the headings, as the web pages of a repository make them."""
    headings = re.findall(r"^#+ +(.+?) *$", FENCE.sub("", page.read_text("utf-8")), re.MULTILINE)
    plain = (re.sub(r"[`*]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", h)) for h in headings)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in plain}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    broken = []
    for target in LINK.findall(text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        if not there.exists() or ROOT not in (there, *there.parents):
            broken.append(target)
        elif anchor and there.suffix == ".md" and anchor not in anchors(there):
            broken.append(target)
    assert not broken


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_code_is_fenced_with_its_language(page):
    languages = {language for language, _ in FENCE.findall(page.read_text(encoding="utf-8"))}
    assert languages <= {"python", "bash", "text", "toml", "c", "cmake", "cpp", "json"}


@pytest.mark.parametrize(
    "page", [p for p in PAGES if "```python" in p.read_text("utf-8")], ids=name
)
def test_python_blocks_run(page, tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    if page.stem in ("grid_liquid", "rendering", "rigid_robots"):
        pytest.importorskip("pyvista", reason="PyVista is not installed")
    if page.stem == "sweeps":
        pytest.importorskip("distributed", reason="Dask is not installed")
    if page.stem == "rigid_robots":
        pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    text = page.read_text(encoding="utf-8")
    shared = ROOT.parent / "shared"  # data beside the clone
    if shared.is_dir():
        (tmp_path / "shared").symlink_to(shared)
    elif "../shared" in text:
        pytest.skip("needs ../shared, which is not here")
    (tmp_path / "clone").mkdir()
    monkeypatch.chdir(tmp_path / "clone")
    blocks = [(match.start(2), match[2]) for match in FENCE.finditer(text) if match[1] == "python"]
    assert blocks
    names = {"__name__": "__main__"}
    for start, code in blocks:
        for module in re.findall(r"^ *(?:import|from) +(\w+)", code, re.MULTILINE):
            if module in OPTIONAL and importlib.util.find_spec(module) is None:
                pytest.skip(f"{module} is not installed")
        # Line numbers in a traceback are then those of the page.
        padded = "\n" * text.count("\n", 0, start) + code
        exec(compile(padded, name(page), "exec"), names)


def test_every_scene_is_in_the_gallery():
    shown = re.findall(r"\(scenes\.md#([\w-]+)\)", (ROOT / "docs/gallery.md").read_text("utf-8"))
    assert sorted(shown) == sorted(substep.scenes.catalogue.BUILT_IN)


def test_tests_that_are_named_exist():
    named = {
        (page.name, test)
        for page in PAGES
        for test in re.findall(r"`(tests/[\w/]+\.\w+::[\w:]+)`", page.read_text("utf-8"))
    }
    assert len(named) > 100
    missing = []
    for page, test in sorted(named):
        path, *_, name = test.split("::")
        there = ROOT / path
        begin = "def " if there.suffix == ".py" else r"TEST\(\w+, "
        if not there.is_file() or not re.search(rf"{begin}{name}\b", there.read_text("utf-8")):
            missing.append(f"{page}: {test}")
    assert not missing


def test_each_row_of_what_is_promised_names_its_test():
    rows = re.findall(r"^\|.*\|$", (ROOT / "docs/reliability.md").read_text("utf-8"), re.MULTILINE)
    heads = ("| input |", "|---|")
    assert not [row for row in rows if not row.startswith(heads) and "`tests/" not in row]


def figures():
    path = ROOT / "docs" / "figures" / "make.py"
    spec = importlib.util.spec_from_file_location("make_figures", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_figure_of_the_script_is_there():
    pytest.importorskip("matplotlib")
    drawn = {path.stem for path in (ROOT / "docs" / "figures").glob("*.png")}
    assert drawn >= set(figures().FIGURES)


def test_figures_can_be_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    module = figures()
    names = sorted(set(module.FIGURES) - {"hero"})
    module.main(names, tmp_path)
    for name in names:
        assert 10_000 < (tmp_path / f"{name}.png").stat().st_size < 120_000
