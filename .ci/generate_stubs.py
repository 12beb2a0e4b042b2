"""Writes python/substep/_core.pyi from the built module; with --check, only says how it differs.

pybind11-stubgen reads the signatures, a table puts the types that our Python passes in the place of
its own, ruff formats. What depends on the machine (the values of variables) is left out.
"""

import ast
import difflib
import subprocess
import sys
import tempfile
from pathlib import Path

import pybind11_stubgen
import substep

STUB = Path(__file__).parents[1] / "python/substep/_core.pyi"
HEAD = "# Written by .ci/generate_stubs.py: change the bindings, not this file.\n"

# What pybind11-stubgen prints, and what stands in its place.
TYPES = {
    "typing.SupportsFloat | typing.SupportsIndex": "float",
    "typing.SupportsInt | typing.SupportsIndex": "int",
    "collections.abc.Sequence[float]": "collections.abc.Sequence[float] | "
    "numpy.typing.NDArray[typing.Any]",
    "dict": "dict[str, typing.Any]",
    "list": "list[typing.Any]",
    "tuple": "tuple[typing.Any, ...]",
    "numpy.ndarray": "numpy.typing.NDArray[typing.Any]",
}


class Types(ast.NodeTransformer):
    """Replaces types by the table, the inner ones first."""

    def visit(self, node: ast.AST) -> ast.AST:
        node = super().visit(node)
        new = TYPES.get(ast.unparse(node))
        return ast.parse(new, mode="eval").body if new else node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        if ast.unparse(node.value) == "typing.Annotated":  # with what no type checker looks at
            assert isinstance(node.slice, ast.Tuple)
            return self.visit(node.slice.elts[0])
        node.slice = self.visit(node.slice)
        return node


class Stub(ast.NodeTransformer):
    """Replaces all types; leaves out docstrings and the values of variables."""

    def visit_arguments(self, node: ast.arguments) -> ast.arguments:
        for arg in (*node.posonlyargs, *node.args, *node.kwonlyargs):
            arg.annotation = arg.annotation and Types().visit(arg.annotation)
        positional = [*node.posonlyargs, *node.args]
        defaults = [None] * (len(positional) - len(node.defaults)) + node.defaults
        defaults += node.kw_defaults
        for arg, default in zip(positional + node.kwonlyargs, defaults, strict=True):
            # A pointer that may be null is printed like any other.
            if isinstance(default, ast.Constant) and default.value is None and arg.annotation:
                if not ast.unparse(arg.annotation).endswith(("None", "typing.Any")):
                    arg.annotation = ast.BinOp(arg.annotation, ast.BitOr(), default)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        self.visit(node.args)
        node.returns = node.returns and Types().visit(node.returns)
        node.body = [ast.Expr(ast.Constant(...))]
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AnnAssign | None:
        node.annotation, node.value = Types().visit(node.annotation), None
        return None if ast.unparse(node.target) == "__all__" else node

    def visit_Expr(self, node: ast.Expr) -> None:
        return None


def stub_of(printed: str) -> str:
    """What pybind11-stubgen printed, as the file has it."""
    tree = ast.fix_missing_locations(Stub().visit(ast.parse(printed)))
    text = HEAD + ast.unparse(tree)
    for arguments in (["check", "--fix-only", "--select=I"], ["format"]):
        command = [sys.executable, "-m", "ruff", *arguments, "--stdin-filename", STUB, "-"]
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
        text = done.stdout
    return text


def generated() -> str:
    """The stub of the module that `import substep` finds."""
    assert substep._core.__name__ == "substep._core"  # loads it
    with tempfile.TemporaryDirectory() as folder:
        sys.argv = ["pybind11-stubgen", "substep._core", "-o", folder, "--exit-code"]
        pybind11_stubgen.main()
        (stub,) = Path(folder).rglob("_core.pyi")
        return stub_of(stub.read_text())


if __name__ == "__main__":
    check = "--check" in sys.argv
    text, committed = generated(), STUB.read_text()
    if check and text != committed:
        lines = committed.splitlines(), text.splitlines()
        print(*difflib.unified_diff(*lines, "committed", "generated", lineterm="", n=1), sep="\n")
        sys.exit("python/substep/_core.pyi: not what `python .ci/generate_stubs.py` writes")
    STUB.write_text(text)
