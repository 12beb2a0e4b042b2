"""The site: `script/site` builds it from these pages, the course and the docstrings."""

import importlib
import inspect
import re
from pathlib import Path

import substep

project = "substep"
author = "the authors of substep"
project_copyright = author
version = release = substep.__version__

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_design",
]
exclude_patterns = ["_templates", "figures"]
suppress_warnings = ["config.cache", "myst-nb.lexer"]  # the latter where notebooks are not run

myst_enable_extensions = ["attrs_inline", "colon_fence", "dollarmath"]
myst_heading_anchors = 4
myst_dmath_double_inline = True
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_show_tb = True
nb_code_prompt_show = "Show the solution"  # hidden cells are those of exercises
nb_code_prompt_hide = "Hide the solution"

autosummary_generate = True
autodoc_default_options = {"members": True, "inherited-members": True}
autodoc_typehints = "none"
numpydoc_show_class_members = False

templates_path = ["_templates"]
toc_object_entries_show_parents = "hide"

html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_sidebars = {
    page: [] for page in ("index", "which_solver", "gallery", "validation", "performance")
}
html_title = "substep"
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "header_links_before_dropdown": 10,
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
}

API = Path(__file__).parent / "api"
HEAD = """Reference
=========

Every public name, with its parameters, units and errors. Names of the first list are those of
``substep`` itself; the others are in its modules.
"""


def is_module(name):
    """Whether a public name is that of a module."""
    return inspect.ismodule(getattr(substep, name))


def public_names():
    """Names by module, each once: those of substep, then what is in its modules alone."""
    names = {"substep": [name for name in substep.__all__ if not is_module(name)]}
    for module in filter(is_module, substep.__all__):
        inside = importlib.import_module(f"substep.{module}")
        names[f"substep.{module}"] = [
            name
            for name in getattr(inside, "__all__", ())
            if getattr(substep, name, None) is not getattr(inside, name)
            and callable(getattr(inside, name))
        ]
    return {module: found for module, found in names.items() if found}


def write_reference(app, config):
    """Writes the page that lists every public name; autosummary makes a page for each."""
    text = HEAD
    for module, names in public_names().items():
        title = f"``{module}``"
        listed = "\n".join(f"   {name}" for name in sorted(names, key=str.lower))
        text += f"\n{title}\n{'-' * len(title)}\n\n.. currentmodule:: {module}\n\n"
        text += f".. autosummary::\n   :toctree: .\n   :nosignatures:\n\n{listed}\n"
    API.mkdir(exist_ok=True)
    page = API / "index.rst"
    if not page.exists() or page.read_text("utf-8") != text:
        page.write_text(text, "utf-8")


def docstring(app, what, name, obj, options, lines):
    """Makes a docstring fit for a page.

    In ours |x| is an absolute value, which would be a substitution, and pages are named by their
    files.
    """
    for k, line in enumerate(lines):
        line = re.sub(r"(?<!`)\bdocs/([\w-]+)\.md", r":doc:`/\1`", line)
        parts = re.split(r"(``.*?``|`.*?`)", line)
        parts[::2] = [re.sub(r"(?<!\\)\|", r"\\|", part) for part in parts[::2]]
        lines[k] = "".join(parts)


def page(app, name, source):
    """Links whose text is the name of a file get the title of what they lead to."""
    source[0] = re.sub(r"\[[\w-]+\.md\]\(([\w-]+\.md(?:#[\w-]+)?)\)", r"[](\1)", source[0])


def setup(app):
    """Called by Sphinx."""
    app.connect("config-inited", write_reference)
    app.connect("source-read", page)
    app.connect("autodoc-process-docstring", docstring, priority=900)
