"""Prints the folders of python/substep and cpp/substep side by side.

    python .ci/print_house.py            prints them
    python .ci/print_house.py --write    puts them into docs/architecture.md, between its marks

What a folder is about is the first line of its Python package; for those of C++ alone it is here.
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/architecture.md"
MARKS = "<!-- python .ci/print_house.py -->\n```text\n", "```\n<!-- the end of the tree -->\n"
ONLY_CPP = {
    "core": "Errors, interrupts, parallel loops, random numbers, lanes, small matrices.",
    "gridfluid/flow": "Flows that fill their box: advection, diffusion, stresses, and the step.",
    "gridfluid/grid": "Where numbers are: cells, faces, ghosts and rows; loops and interpolation.",
    "gridfluid/liquid": "Liquids with a free surface: the step.",
    "gridfluid/particles": "Particles of a liquid: transfers, motion, density, surface.",
    "gridfluid/pressure": "Obstacles that cut cells, and the projection with its multigrid solver.",
    "linalg/direct": "Factorizations: our own, and those of SuiteSparse.",
    "mpm/boundary": "Obstacles at nodes and at particles.",
    "mpm/general": "Transfers of any order, scheme and form, to test the fast ones against.",
    "mpm/implicit": "The implicit step.",
    "mpm/materials": "Formulas of materials over lanes, and their list.",
    "mpm/particles": "Packets of particles, sorted by block and cell.",
    "mpm/passes": "The fast, fused transfers, instantiated for each material.",
    "mpm/solver": "The steps: P2G, update of the grid, G2P.",
    "ode/explicit": "Tables of Runge-Kutta methods, and stabilised ones.",
    "ode/implicit": "Implicit methods, their Newton iterations and matrices.",
    "ode/solve": "Whole solutions: events, output, ensembles.",
    "ode/stepping": "What a step is, and how long it may be.",
    "ode/symplectic": "Methods for equations of second order.",
    "pbd/constraints": "Formulas of constraints over lanes, and their list.",
    "pbd/contact": "Self-collision and obstacles.",
    "pbd/groups": "Constraints of one kind, projected together.",
    "pbd/solver": "The sweeps over all groups, in phases without conflicts.",
    "rigid/collision": "Where shapes touch: broad and narrow phase, manifolds, times of impact.",
    "rigid/distance": "Distances and directions between convex shapes.",
    "rigid/motion": "Bodies, their mass, and their free motion.",
    "rigid/shapes": "Shapes and what they are made of.",
    "rigid/solver": "Contacts, joints, impacts and islands.",
    "rigid/world": "The step, queries, batches, and all that is saved.",
    "transfer": "Between particles and grids: weights, the affine transfer, sparse blocks.",
}


def folders(root: Path, *suffixes: str) -> set[str]:
    """Those below `root` with such files in them or further down, by their names from there."""
    return {
        folder.as_posix()
        for path in root.rglob("*")
        if path.suffix in suffixes
        for folder in path.relative_to(root).parents[:-1]
    }


def about(name: str) -> str:
    """The first line of the package or module of this name."""
    for path in (f"{name}/__init__.py", f"{name}.py"):
        if (source := ROOT / "python/substep" / path).is_file():
            return (ast.get_docstring(ast.parse(source.read_text())) or "").split("\n")[0]
    return ONLY_CPP.get(name, "")


def tree() -> str:
    """The rows: Python, C++, and what the folder is about."""
    python, cpp = folders(ROOT / "python/substep", ".py"), folders(ROOT / "cpp/substep", ".h")
    modules = {path.stem for path in (ROOT / "python/substep").glob("[a-z]*.py")}
    lines = [f"{'python/substep/':20}{'cpp/substep/':20}", ""]
    for name in sorted(python | cpp | modules, key=lambda name: name.split("/")):
        *above, last = name.split("/")
        shown = "  " * len(above) + last
        left = f"{shown}.py" if name in modules else f"{shown}/" if name in python else ""
        right = f"{shown}/" if name in cpp else ""
        lines.append(f"{left:20}{right:20}{about(name)}")
    return "".join(line.rstrip() + "\n" for line in lines)


def with_tree(text: str) -> str:
    """The page with the tree of now between its marks."""
    before, _, rest = text.partition(MARKS[0])
    return before + MARKS[0] + tree() + MARKS[1] + rest.partition(MARKS[1])[2]


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(with_tree(PAGE.read_text()))
    else:
        print(tree(), end="")
