"""Checks that the arrows between the folders of cpp/substep run one way (docs/architecture.md).

Bindings are compiled once for all instruction levels, so they may see no header that looks at one.
"""

import graphlib
import re
import sys
from pathlib import Path

SHARED = {"linalg", "geometry", "transfer"}  # the floor between core and the method folders

# Inside a folder: each sub-folder includes itself and those before it. "." are the files beside
# the sub-folders. A folder that is not here has none.
INSIDE = {
    "gridfluid": ["grid", "particles", "pressure", "flow", "viscosity", "liquid"],
    "linalg": [".", "direct"],
    "mpm": ["materials", "particles", "boundary", "passes", "general", "implicit", "solver"],
    "ode": ["stepping", "explicit", "implicit", "symplectic", "systems", "solve"],
    "pbd": ["constraints", "groups", "contact", "solver"],
    "rigid": ["shapes", "distance", "motion", "collision", "solver", "world"],
}

LOOKS_AT_LEVEL = re.compile(r"__(AVX|SSE|FMA)|immintrin\.h")


def allowed(folder: str) -> set[str]:
    """Folders whose headers `folder` may include."""
    if folder == "core":
        return {"core"}
    if folder in SHARED:
        return {"core", folder}
    return {"core", folder} | SHARED


def complaint(folder: str, inside: str, target: str, target_inside: str) -> str | None:
    """Why a file of `folder`/`inside` may not include one of `target`/`target_inside`."""
    if target not in allowed(folder):
        return "the arrow points the wrong way"
    order = INSIDE.get(target, ["."])
    if target_inside not in order:
        return f"{target} has no folder {target_inside}"
    if target == folder and order.index(inside) < order.index(target_inside):
        return f"{inside} comes before {target_inside}"
    return None


def wrong_includes(root: Path) -> list[str]:
    """One line for each include that points the wrong way, or that closes a circle of headers."""
    found = []
    headers: dict[str, set[str]] = {}
    files = [path for path in (root / "substep").rglob("*") if path.is_file()]
    for path in sorted(files):
        name = path.relative_to(root).as_posix()
        folder, *between = path.relative_to(root / "substep").parts[:-1]
        inside = "/".join(between) or "."
        if inside not in INSIDE.get(folder, ["."]):
            found.append(f"{path}: .ci/check_includes.py does not know the folder {inside}")
            continue
        for number, line in enumerate(path.read_text().splitlines(), 1):
            include = re.match(r'\s*#\s*include\s*[<"]([^>"]+)[>"]', line)
            if not include:
                continue
            where = f"{path}:{number}: includes {include[1]}"
            target = re.fullmatch(r"substep/([^/]+)/(?:(.+)/)?[^/]+", include[1])
            if target:
                why = complaint(folder, inside, target[1], target[2] or ".")
                if why:
                    found.append(f"{where}: {why}")
                if path.suffix == ".h":
                    headers.setdefault(name, set()).add(include[1])
            elif line.count('"') == 2:
                found.append(f"{where}: write the path from cpp/")
            elif re.match(r"pybind11|Python\.h|bindings", include[1]):
                found.append(f"{where}: only cpp/bindings knows Python")
    try:
        graphlib.TopologicalSorter(headers).prepare()
    except graphlib.CycleError as circle:
        found.append("a circle of headers: " + " <- ".join(circle.args[1]))
    return found


def levels_seen(root: Path) -> list[str]:
    """One line for each file of the bindings that sees a header which looks at the level."""
    text = {p.relative_to(root).as_posix(): p.read_text() for p in root.rglob("*.[hc]*")}
    found = []
    for name in sorted(n for n in text if n.startswith("bindings/")):
        way: dict[str, str] = {name: ""}  # each header, and who includes it
        open_ends = [name]
        while open_ends:
            last = open_ends.pop()
            for include in re.findall(r'#\s*include "([^"]+)"', text[last]):
                target = include if include in text else f"bindings/{include}"
                if target in text and target not in way:
                    way[target] = last
                    open_ends.append(target)
        for header in [h for h in way if h != name and LOOKS_AT_LEVEL.search(text[h])][:1]:
            steps = [header]
            while way[steps[-1]]:
                steps.append(way[steps[-1]])
            found.append(" <- ".join(steps) + ": bindings see no instruction level")
    return found


if __name__ == "__main__":
    cpp = Path(__file__).parents[1] / "cpp"
    lines = wrong_includes(cpp) + levels_seen(cpp)
    print("\n".join(lines) or "includes: the arrows run one way, inside folders too")
    sys.exit(bool(lines))
