"""Every public name has the parts of a numpydoc docstring, and its examples run."""

import dataclasses
import doctest
import inspect
import re

import numpy as np
import pytest
import substep

SECTION = re.compile(r"^([A-Z][A-Za-z ]+)\n-{3,}$", re.MULTILINE)


def is_exception(value):
    return inspect.isclass(value) and issubclass(value, BaseException)


def public_objects():
    """Yields the name and value of each public function, class and method."""
    for name in substep.__all__:
        value = getattr(substep, name)
        if not inspect.ismodule(value):
            yield name, value
            continue
        for inner in getattr(value, "__all__", ()):
            if getattr(substep, inner, None) is not getattr(value, inner):
                yield f"{name}.{inner}", getattr(value, inner)


OBJECTS = {name: value for name, value in public_objects() if callable(value)}
CLASSES = {n: v for n, v in OBJECTS.items() if inspect.isclass(v) and not is_exception(v)}
FUNCTIONS = {n: v for n, v in OBJECTS.items() if not inspect.isclass(v)}
METHODS = {
    f"{name}.{attribute}": member
    for name, cls in CLASSES.items()
    for attribute, member in inspect.getmembers(cls)
    if not attribute.startswith("_")
    and inspect.isroutine(member)
    and (getattr(member, "__module__", None) or "").startswith("substep")
}


def docstring(value):
    text = inspect.getdoc(value)
    assert text, "no docstring"
    return text


def sections(text):
    return set(SECTION.findall(text))


def section_body(text, title):
    start = next(m.end() for m in SECTION.finditer(text) if m[1] == title)
    following = SECTION.search(text, start)
    return text[start : following.start() if following else None]


def parameters(value):
    return [
        p.name
        for p in inspect.signature(value).parameters.values()
        if p.name not in ("self", "cls") and not p.name.startswith("_")
    ]


def described(text, *titles):
    """Names at the left margin of the sections: `a, b : float`."""
    titles = [t for t in titles if t in sections(text)]
    lines = "\n".join(section_body(text, title) for title in titles).splitlines()
    heads = [line.split(":")[0] for line in lines if line and not line.startswith(" ")]
    return {name.strip().lstrip("*") for head in heads for name in head.split(",")}


def check_parameters(value, text):
    names = parameters(value)
    if names:
        assert "Parameters" in sections(text), "no Parameters section"
        found = described(text, "Parameters", "Other Parameters")
        assert set(names) <= found, f"not described: {set(names) - found}"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_docstring(name):
    value = FUNCTIONS[name]
    text = docstring(value)
    check_parameters(value, text)
    assert "Examples" in sections(text), "no Examples section"
    if inspect.signature(value).return_annotation not in (None, "None", "NoReturn"):
        assert sections(text) & {"Returns", "Yields"}, "no Returns section"
    if parameters(value):
        assert "Raises" in sections(text), "no Raises section"


@pytest.mark.parametrize("name", CLASSES)
def test_class_docstring(name):
    value = CLASSES[name]
    text = docstring(value)
    if dataclasses.is_dataclass(value) and "Attributes" in sections(text):
        fields = {field.name for field in dataclasses.fields(value)}
        assert fields <= described(text, "Attributes")
        return  # a result: the function that returns it has the example
    assert "Examples" in sections(text), "no Examples section"
    if inspect.isfunction(value.__init__):
        check_parameters(value.__init__, text)


@pytest.mark.parametrize("name", METHODS)
def test_method_docstring(name):
    value = METHODS[name]
    text = docstring(value)
    for parameter in parameters(value):
        assert re.search(rf"\b{parameter}\b", text), f"{parameter} is not described"


# What SciPy calls with options of its own.
OF_SCIPY = {"Euler", "Midpoint", "Heun", "RK4", "RK45", "DOP853", "ImplicitEuler", "Radau"}


def test_every_signature_names_its_keywords():
    hiding = {
        name
        for name, value in {**OBJECTS, **METHODS}.items()
        if hasattr(made := value.__init__ if inspect.isclass(value) else value, "__module__")
        and made.__module__.startswith("substep")
        for parameter in inspect.signature(made).parameters.values()
        if parameter.kind == parameter.VAR_KEYWORD
    }
    assert hiding == OF_SCIPY


@pytest.mark.parametrize("name", [n for n, v in OBJECTS.items() if is_exception(v)])
def test_exception_docstring(name):
    assert docstring(OBJECTS[name])


def test_the_collection_is_not_empty():
    assert {"solve_ivp", "advect", "state_hash"} <= FUNCTIONS.keys()
    assert {"Advection", "Recorder"} <= CLASSES.keys()
    assert "Advection.advance" in METHODS


# By the function: classes share those that they inherit from what is not public.
INHERITED = {
    getattr(member, "__func__", member): name
    for name, member in METHODS.items()
    for cls, _, attribute in [name.rpartition(".")]
    if attribute not in vars(CLASSES[cls]) and ">>>" in (member.__doc__ or "")
}


@pytest.mark.parametrize(
    "name", [*(n for n, v in OBJECTS.items() if ">>>" in (v.__doc__ or "")), *INHERITED.values()]
)
def test_examples_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    value = OBJECTS.get(name) or METHODS[name]
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    runner = doctest.DocTestRunner(optionflags=flags)
    finder = doctest.DocTestFinder(recurse=inspect.isclass(value))
    report = []
    with np.printoptions(legacy=False):
        for test in finder.find(value, name, globs={}):
            runner.run(test, out=report.append)
    assert runner.summarize(verbose=False).attempted > 0
    assert runner.failures == 0, "".join(report)
