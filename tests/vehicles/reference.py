"""The Modelica Association's Reference-FMUs, built from source."""

import subprocess
import zipfile
from pathlib import Path

from trimtab.compiler.native.compiler import find_compiler
from trimtab.export.fmu import SOURCES, find_platform

FOLDER = Path(__file__).parent / "reference_fmus"


def build_reference(name, version, folder):
    """The FMU of one model; its path."""
    platform, suffix = find_platform(version)
    binary = folder / f"{name}{version}{suffix}"
    files = [FOLDER / name / "model.c", FOLDER / "src" / f"fmi{version}Functions.c", FOLDER / "src" / "cosimulation.c"]
    includes = [f"-I{FOLDER / name}", f"-I{FOLDER / 'src'}", f"-I{SOURCES}"]
    flags = ["-shared", "-fPIC", "-O1", f"-DFMI_VERSION={version}", "-DDISABLE_PREFIX", *includes]
    subprocess.run([find_compiler("c").path, *flags, *files, "-o", binary, "-lm"], check=True)
    path = folder / f"{name}{version}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(FOLDER / name / f"FMI{version}.xml", "modelDescription.xml")
        archive.write(binary, f"binaries/{platform}/{name}{suffix}")
    return path


def reference_rows(name):
    """What the model's makers publish as its result."""
    return (FOLDER / name / f"{name}_out.csv").read_text().splitlines()
