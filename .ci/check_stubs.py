"""Generates stubs from the built module and compares them with python/substep/_core.pyi.

The types in _core.pyi are written by hand, because those of pybind11 are wide; names, classes and
parameter names must be those of the module.
"""

import ast
import sys
import tempfile
from pathlib import Path

import pybind11_stubgen
import substep

STUB = Path(__file__).parents[1] / "python/substep/_core.pyi"


def surface(body: list[ast.stmt], prefix: str = "") -> dict[str, str]:
    """Each public name with its parameters."""
    found: dict[str, str] = {}
    for node in body:
        if isinstance(node, ast.ClassDef):
            found[prefix + node.name] = "class"
            found |= surface(node.body, f"{prefix}{node.name}.")
        elif isinstance(node, ast.FunctionDef):
            names = [
                a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            ]
            if any(isinstance(d, ast.Name) and d.id == "property" for d in node.decorator_list):
                found[prefix + node.name] = "attribute"
            elif not any(isinstance(d, ast.Attribute) for d in node.decorator_list):  # no setter
                found[prefix + node.name] = f"({', '.join(names)})"
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found[prefix + node.target.id] = "attribute"
    return {
        name: what
        for name, what in found.items()
        if not any(part.startswith("_") and part != "__init__" for part in name.split("."))
    }


def generated() -> dict[str, str]:
    """The surface of the built module."""
    assert substep._core.__name__ == "substep._core"  # loads it
    with tempfile.TemporaryDirectory() as folder:
        sys.argv = ["pybind11-stubgen", "substep._core", "-o", folder, "--ignore-all-errors"]
        pybind11_stubgen.main()
        (stub,) = Path(folder).rglob("_core.pyi")
        return surface(ast.parse(stub.read_text()).body)


if __name__ == "__main__":
    module, stub = generated(), surface(ast.parse(STUB.read_text()).body)
    wrong = [
        f"{name}: module {module.get(name, 'nothing')}, _core.pyi {stub.get(name, 'nothing')}"
        for name in sorted(module.keys() | stub.keys())
        if module.get(name) != stub.get(name)
    ]
    print("\n".join(wrong) or f"stubs: {len(stub)} names agree")
    sys.exit(bool(wrong))
