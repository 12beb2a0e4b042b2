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


def members(body: list[ast.stmt]) -> dict[str, str | dict]:
    """Each name with its parameters; a class with its own and its inherited members."""
    found: dict[str, str | dict] = {}
    for node in body:
        if isinstance(node, ast.ClassDef):
            found[node.name] = {}
            for base in node.bases:
                found[node.name] |= found.get(ast.unparse(base), {})
            found[node.name] |= members(node.body)
        elif isinstance(node, ast.FunctionDef):
            decorators = [ast.unparse(d) for d in node.decorator_list]
            args = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            if "property" in decorators:
                found[node.name] = "attribute"
            elif not any(d.endswith(".setter") for d in decorators):
                found[node.name] = f"({', '.join(a.arg for a in args if a.arg != 'self')})"
        elif isinstance(node, ast.AnnAssign):
            found[ast.unparse(node.target)] = "attribute"
        elif isinstance(node, ast.Assign) and ast.unparse(node.value) in found:  # Other = Name
            found[ast.unparse(node.targets[0])] = found[ast.unparse(node.value)]
    return found


def surface(body: list[ast.stmt]) -> dict[str, str]:
    """Each public name, also `Class.name`, with its parameters."""
    flat: dict[str, str] = {}
    for name, what in members(body).items():
        if isinstance(what, dict):
            flat[name] = "class"
            flat |= {f"{name}.{n}": str(w) for n, w in what.items()}
        else:
            flat[name] = what
    keep = ("__init__", "__call__")
    return {
        name: what
        for name, what in flat.items()
        if not any(part.startswith("_") and part not in keep for part in name.split("."))
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
