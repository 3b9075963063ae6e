"""Documents of a release agree with the package: version, licences, extras, citation, changelog."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

import pytest
from release.licences import DEVELOPERS, find_packages, find_requirements, licence, read_rows

import trimtab

ROOT = Path(__file__).parents[2]
COPYLEFT = re.compile(r"GPL|MPL|EUPL|CeCILL|SSPL", re.IGNORECASE)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_version_is_defined_once_and_documents_agree():
    assert "version" not in PROJECT["project"]
    assert PROJECT["tool"]["hatch"]["version"] == {"path": "src/trimtab/__init__.py"}
    assert re.search(r"^version: (\S+)$", read("CITATION.cff"), re.MULTILINE)[1] == trimtab.__version__
    assert re.search(r"^## (\S+)", read("CHANGELOG.md"), re.MULTILINE)[1] == trimtab.__version__
    assert f"Version {trimtab.__version__.rpartition('.')[0]}" in read("README.md")


def test_every_dependency_is_listed_with_its_licence():
    """On another Python the licence text of a package may be longer, and fewer packages may be needed."""
    rows = read_rows()
    assert len(rows) > 70
    for name, doors in find_packages().items():
        assert name in rows, f"{name} is missing: python tests/release/licences.py"
        listed, here = rows[name][0], licence(distribution(name))
        assert listed.startswith(here) or here.startswith(listed), f"{name}: {listed}, {here}"
        assert set(doors) <= set(rows[name][1].split(", ")), name


def test_required_dependencies_are_permissive_and_copyleft_is_named():
    copyleft = {name for name, (text, _) in read_rows().items() if COPYLEFT.search(text)}
    assert copyleft == {"pymavlink"}
    assert "always" not in read_rows()["pymavlink"][1]
    assert "pymavlink alone is under a copyleft licence" in read("docs/licences.md")


@pytest.mark.parametrize("extra", PROJECT["project"]["optional-dependencies"])
def test_every_extra_is_documented(extra):
    """Extras for users are in the README's table, those for developers in CONTRIBUTING."""
    page = read("CONTRIBUTING.md") if extra in DEVELOPERS else read("README.md")
    assert re.search(rf"^\| `{extra}` \| .+ \|$", page, re.MULTILINE), extra


@pytest.mark.thorough
def test_every_package_of_an_extra_is_imported():
    """What a user's extra brings is imported somewhere in the package or by a study."""
    text = "\n".join(p.read_text(encoding="utf-8") for d in ("src", "studies") for p in (ROOT / d).rglob("*.py"))
    for extra, requirements in find_requirements().items():
        for requirement in requirements:
            name = re.split(r"[<>=\[]", requirement)[0]
            module = {"markdown-it-py": "markdown_it", "rerun-sdk": "rerun"}.get(name, name.replace("-", "_"))
            assert re.search(rf"(?:import|from) {module}\b|\"{module}[.\"]", text), f"{extra}: nothing imports {module}"


@pytest.mark.real_time
def test_importing_the_package_takes_less_than_a_tenth_of_a_second():
    took = []
    for _ in range(3):
        command = [sys.executable, "-X", "importtime", "-c", "import trimtab"]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
        (line,) = [line for line in said.splitlines() if re.search(r"\|\s+trimtab$", line)]
        took.append(int(line.split("|")[1]) / 1e6)
    print("import trimtab (s):", took)
    assert min(took) < 0.1
