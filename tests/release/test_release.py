"""The source archive and the wheel of a release are small and complete, and work in a clean environment."""

import email
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.metadata import Metadata
from packaging.utils import parse_sdist_filename, parse_wheel_filename

import trimtab

ROOT = Path(__file__).parents[2]
LIMIT = 2_000_000
BUILDER = "hatchling==1.27.0"
BUILD = "import sys; from hatchling import build; print(getattr(build, sys.argv[1])(sys.argv[2]))"
MACHINE_PATH = re.compile(rb"(?<![\w.-])/(?:home|root|work)/")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def run(*command, cwd, **more):
    """Run a command that knows nothing of this checkout; its output, where it succeeds."""
    own = ("PYTHON", "VIRTUAL_ENV", "TRIMTAB")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(own)} | more
    done = subprocess.run([str(c) for c in command], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def find_pythons():
    """The Python of this test, and 3.13 where it is another and there is one."""
    found = [Path(sys.executable)]
    if sys.version_info[:2] != (3, 13):
        versions = sorted((Path.home() / ".pyenv" / "versions").glob("3.13*/bin/python"))
        found += versions[-1:] or ([Path(other)] if (other := shutil.which("python3.13")) else [])
    return found


@pytest.fixture(scope="module")
def release(tmp_path_factory):
    """The source archive, made from a copy of what git knows, and the wheel, made from the unpacked archive."""
    folder = tmp_path_factory.mktemp("release")
    run(sys.executable, "-m", "venv", folder / "tool", cwd=folder)
    python = folder / "tool" / "bin" / "python"
    run(python, "-m", "pip", "install", "-q", BUILDER, cwd=folder)
    copy = folder / "copy"
    for name in run("git", "-c", f"safe.directory={ROOT}", "ls-files", "-co", "--exclude-standard", cwd=ROOT).split(
        "\n"
    ):
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, copy / name)
    archive = folder / run(python, "-c", BUILD, "build_sdist", folder, cwd=copy).split()[-1]
    with tarfile.open(archive) as file:
        file.extractall(folder / "unpacked", filter="data")
    (source,) = (folder / "unpacked").iterdir()
    wheel = folder / run(python, "-c", BUILD, "build_wheel", folder, cwd=source).split()[-1]
    return archive, wheel


def contents(path):
    """Name and bytes of each file; an archive's without its first folder."""
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as file:
            return {name: file.read(name) for name in file.namelist() if not name.endswith("/")}
    with tarfile.open(path) as file:
        members = [m for m in file.getmembers() if m.isfile()]
        return {m.name.partition("/")[2]: file.extractfile(m).read() for m in members}


@pytest.mark.thorough
def test_archive_and_wheel_are_small_and_contain_only_needed_files(release):
    archive, wheel = release
    print({path.name: path.stat().st_size for path in release})
    assert all(path.stat().st_size < LIMIT for path in release)
    in_archive, in_wheel = contents(archive), contents(wheel)
    package = {str(p.relative_to(ROOT / "src")) for p in (ROOT / "src").rglob("*") if p.is_file()}
    package = {name for name in package if "__pycache__" not in name}
    firmware = {f"trimtab/{p.relative_to(ROOT)}" for p in (ROOT / "firmware").rglob("*") if p.is_file()}
    own = {name for name in in_wheel if ".dist-info/" not in name}
    assert own == package | firmware
    assert {"trimtab/py.typed", "trimtab/__init__.pyi"} <= own
    folders = {name.split("/")[0] for name in in_archive}
    assert {"src", "firmware", "examples", "constraints.txt", "README.md", "LICENSE", "CHANGELOG.md"} <= folders
    assert not folders & {"tests", "docs", "studies", "benchmarks", ".ci"}
    for name, text in (in_archive | in_wheel).items():
        assert not MACHINE_PATH.search(text), name


@pytest.mark.thorough
def test_archive_and_wheel_metadata_are_complete(release):
    archive, wheel = release
    assert str(parse_sdist_filename(archive.name)[1]) == trimtab.__version__
    assert str(parse_wheel_filename(wheel.name)[1]) == trimtab.__version__
    (name,) = [n for n in contents(wheel) if n.endswith(".dist-info/METADATA")]
    text = contents(wheel)[name]
    assert contents(archive)["PKG-INFO"] == text
    said = Metadata.from_email(text, validate=True)
    assert (said.name, str(said.version), said.license_expression) == ("trimtab", trimtab.__version__, "MIT")
    assert said.description_content_type == "text/markdown"
    assert email.message_from_bytes(text).get_payload().startswith("# trimtab")
    extras = set(said.provides_extra or ())
    assert extras == set(PROJECT["optional-dependencies"])
    points = contents(wheel)[name.replace("METADATA", "entry_points.txt")].decode()
    assert "trimtab = trimtab.cli:main" in points


@pytest.mark.thorough
@pytest.mark.timeout(900)
@pytest.mark.parametrize("python", find_pythons(), ids=lambda p: f"{p.parents[1].name}/{p.name}")
def test_wheel_flies_in_clean_environment(python, release, tmp_path):
    """Runs the README's commands that need no extra, and `firmware`, from the installed wheel."""
    venv, here = tmp_path / "venv", tmp_path / "here"
    here.mkdir()
    run(python, "-m", "venv", venv, cwd=here)
    pip = venv / "bin" / "python", "-m", "pip"
    run(*pip, "install", "-q", "-c", ROOT / "constraints.txt", f"{release[1]}[wire]", cwd=here)
    run(*pip, "check", cwd=here)

    def call(*words):
        return run(
            venv / "bin" / "trimtab", *words, cwd=here, TRIMTAB_CONFIG=str(tmp_path), TRIMTAB_CACHE=str(tmp_path)
        )

    assert call("--version").split()[-1] == trimtab.__version__
    assert "hovercraft/spin" in call("list")
    assert "wrote bike.py" in call("new", "vehicle", "bike")
    assert "wrote trimtab-demo.png" in call("demo")
    assert (here / "trimtab-demo.png").stat().st_size > 10_000
    assert "yaw_rate" in call("run", "hovercraft/spin", "--json", "--set", "duration=2")
    call("export", "hovercraft/spin", "--out", "spin-c", "--steps", "100")
    assert "same outputs" in call("export", "--verify", "spin-c")
    call("firmware", "hovercraft/forward", "--out", "board")
    assert (here / "board" / "portable" / "vehicle.c").is_file()
    assert (here / "board" / "Makefile").is_file()
