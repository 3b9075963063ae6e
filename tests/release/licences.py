"""The packages that trimtab brings along, and their licences as they say themselves: the table of docs/licences.md.

python tests/release/licences.py        write it anew, in an environment with the extra `test`
"""

import re
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "licences.md"
MARKS = "<!-- packages -->", "<!-- end of packages -->"
DEVELOPERS = ("alltests", "bench", "docs", "foreign", "peers", "test")
"""Extras of who changes trimtab or compares it; a user has none of them."""
CLASSIFIERS = {
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD",
    "GNU Lesser General Public License v3 (LGPLv3)": "LGPL-3.0",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}


def find_requirements() -> dict[str, list[str]]:
    """What pyproject.toml asks for: by "always", and by each extra of a user."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    return {"always": project["dependencies"]} | {e: extras[e] for e in sorted(extras) if e not in DEVELOPERS}


def find_packages() -> dict[str, list[str]]:
    """Each installed package of a user's environment, by whom it is brought: "always" alone, or the extras."""
    brought: dict[str, list[str]] = {}
    for door, requirements in find_requirements().items():
        for name in _closure(requirements):
            brought.setdefault(name, []).append(door)
    return {name: ["always"] if "always" in doors else doors for name, doors in sorted(brought.items())}


def _closure(requirements: list[str]) -> set[str]:
    seen: set[tuple[str, str]] = set()
    waiting = [Requirement(text) for text in requirements]
    while waiting:
        asked = waiting.pop()
        name = canonicalize_name(asked.name)
        for extra in asked.extras or {""}:
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            try:
                needs = [Requirement(text) for text in distribution(name).requires or ()]
            except PackageNotFoundError:
                continue
            waiting += [n for n in needs if n.marker is None or n.marker.evaluate({"extra": extra})]
    return {name for name, _ in seen if _is_installed(name)}


def _is_installed(name: str) -> bool:
    try:
        distribution(name)
    except PackageNotFoundError:
        return False
    return True


def licence(package: Distribution) -> str:
    """As its metadata have it: an expression, else classifiers, else the first line of its licence."""
    said = package.metadata
    if expression := said.get("License-Expression"):
        return expression
    classifiers = [c.rpartition(" :: ")[2] for c in said.get_all("Classifier") or () if c.startswith("License ::")]
    known = [CLASSIFIERS.get(c, c) for c in classifiers if c != "OSI Approved"]
    if known:
        return ", ".join(known)
    lines = (said.get("License") or "").strip().splitlines() or ["?"]
    return lines[0].strip()[:60]


def table() -> str:
    """The rows, between their marks."""
    rows = ["| package | licence | installed always, or by these extras |", "|---|---|---|"]
    for name, doors in find_packages().items():
        rows.append(f"| {name} | {licence(distribution(name))} | {', '.join(doors)} |")
    return "\n".join([MARKS[0], *rows, MARKS[1]])


def read_rows() -> dict[str, tuple[str, str]]:
    """The page's rows: package -> licence, extras."""
    rows = re.findall(r"^\| ([a-z0-9-]+) \| (.+?) \| (.+?) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: (text, doors) for name, text, doors in rows if name != "package"}


if __name__ == "__main__":
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
    PAGE.write_text(before + table() + rest.partition(MARKS[1])[2], encoding="utf-8")
