"""Prints a script that uses each public name: for `mypy --strict`, as a user would run it.

It holds every example of the docstrings, each in a function of its own, and uses each class as a
type and each function as a value.
"""

import doctest
import inspect
import textwrap

import substep


def public_names() -> dict[str, object]:
    """Each public name, also those of public modules, and what it means."""
    found: dict[str, object] = {}
    for name in substep.__all__:
        value = found[f"substep.{name}"] = getattr(substep, name)
        if inspect.ismodule(value):
            found |= {f"substep.{name}.{inner}": getattr(value, inner) for inner in value.__all__}
    return found


def script() -> str:
    """The text of it."""
    names = public_names()
    lines = ["import substep"]
    examples = {
        test.name: "".join(e.source for e in test.examples if doctest.SKIP not in e.options)
        for name, value in names.items()
        if not inspect.ismodule(value)
        for test in doctest.DocTestFinder(recurse=inspect.isclass(value)).find(value, name)
    }
    seen = set()
    for name, source in examples.items():
        if source and source not in seen:
            seen.add(source)
            lines += [
                f"\n\ndef {name.replace('.', '_')}() -> None:",
                textwrap.indent(source, "    "),
            ]
    for name, value in names.items():
        if inspect.isclass(value):
            lines.append(f"def takes_{name.replace('.', '_')}(value: {name}) -> None: ...")
        elif not inspect.ismodule(value):
            lines.append(f"print({name})")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(script(), end="")
