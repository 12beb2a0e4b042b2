"""Checks that the arrows between the folders of cpp/substep run one way (docs/architecture.md)."""

import re
import sys
from pathlib import Path

SHARED = {"linalg", "geometry", "transfer"}  # the floor between core and the method folders


def allowed(folder: str) -> set[str]:
    """Folders whose headers `folder` may include."""
    if folder == "core":
        return {"core"}
    if folder in SHARED:
        return {"core", folder}
    return {"core", folder} | SHARED


def wrong_includes(root: Path) -> list[str]:
    """One line for each include that points the wrong way."""
    found = []
    for path in sorted((root / "substep").glob("*/*")):
        for number, line in enumerate(path.read_text().splitlines(), 1):
            include = re.match(r'\s*#\s*include\s*[<"]([^>"]+)[>"]', line)
            if not include:
                continue
            name = include[1]
            where = f"{path}:{number}: {path.parent.name} includes {name}"
            target = re.match(r"substep/([^/]+)/", name)
            if target and target[1] not in allowed(path.parent.name):
                found.append(where)
            elif line.count('"') == 2 and not target:
                found.append(f"{where}: write the path from cpp/")
            elif re.match(r"pybind11|Python\.h|bindings", name):
                found.append(f"{where}: only cpp/bindings knows Python")
    return found


if __name__ == "__main__":
    lines = wrong_includes(Path(__file__).parents[1] / "cpp")
    print("\n".join(lines) or "includes: the arrows run one way")
    sys.exit(bool(lines))
