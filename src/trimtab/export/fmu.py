"""Export of a scenario's autopilot, vehicle or closed loop as a functional mock-up unit (FMU) for co-simulation.

An FMU is a zip file that contains a description of the variables, a library compiled for this machine, and the C
sources. A simulation tool needs no Python to run the FMU.
Source: FMI 3.0.2 and FMI 2.0.5, Modelica Association, fmi-standard.org.
"""

import platform
import subprocess
import sys
import tempfile
import zipfile
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple
from uuid import UUID

from trimtab.compiler.block import BlockText, block_text
from trimtab.compiler.identifiers import identifier
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.time import to_seconds
from trimtab.export.fmu_description import FmuIdentity, build_description_xml, description_xml
from trimtab.export.fmu_model import FmuModel, FmuVariable, fmu_model, fmu_variables, model_header, split_variables
from trimtab.loop.scenario import Scenario

FMU_PARTS = ("autopilot", "vehicle", "loop")
VERSIONS = (2, 3)
SOURCES = Path(__file__).parent / "fmi"
HEADERS = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
OPTIONS = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-tree-slp-vectorize", "-fwrapv", "-fno-math-errno")
"""Compiler options with which the library computes the same bits as the simulation, on any processor of this
architecture."""
SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib")}


class ExportedFmu(NamedTuple):
    """Result of an FMU export. platform: folder of the library in the FMU, or None if no compiler was found and the FMU
    has no library."""

    path: Path
    block: BlockText
    variables: list[FmuVariable]
    platform: str | None


def export_fmu(
    scenario: Scenario, path: Path, *, version: int = 3, part: str = "autopilot", real: str = "double", seed: int = 0
) -> ExportedFmu:
    """Write a part of a scenario as an FMU.

    Args:
        scenario: scenario, checked completely before any file is written.
        path: path of the FMU to write.
        version: version of FMI, 2 or 3.
        part: "autopilot", "vehicle" or "loop". The input of the autopilot is a frame of samples, and the output is a
            command. The input of the vehicle is a command, and the output is a frame of samples. The loop contains
            both. It has no inputs, and the outputs are all signals.
        real: type of real numbers in the C code, "double" or "single".
        seed: seed of the random numbers. An FMU of a vehicle or loop has the seed as a parameter.

    Raises:
        InputError: the scenario cannot be flown, a primitive cannot be written as C, the compiler fails, or the
            file cannot be written.
    """
    if part not in FMU_PARTS:
        raise InputError("export --fmu", f"unknown part {part!r}", choices=FMU_PARTS, fix=argument("part", "autopilot"))
    if version not in VERSIONS:
        raise InputError(
            "export --fmu", f"unknown FMI version {version}", choices=map(str, VERSIONS), fix=argument("fmu", 3)
        )
    scenario.check()
    model = fmu_model(scenario, part, seed)
    name = identifier(f"{scenario.name}_{part}").lower()
    block = block_text(model.definition._replace(name=name), {"double": "f64", "single": "f32"}[real])
    variables = fmu_variables(model, block)
    if version == 2:
        variables = split_variables(variables)
    about = FmuIdentity(
        scenario=scenario.name,
        part=part,
        identifier=name,
        doc=model.definition.doc,
        token="",
        duration_s=to_seconds(scenario.duration),
        step_s=model.step_s,
        sources=(f"fmi{version}.c", f"{name}.c"),
    )
    files, about = _source_files(version, about, model, block, scenario, variables)
    binary = _compile(about, files, block)
    folder = None
    if binary is not None:
        folder, suffix = find_platform(version)
        files[f"binaries/{folder}/{name}{suffix}"] = binary
    _write_archive(path, files)
    return ExportedFmu(path, block, variables, folder)


def _source_files(
    version: int,
    about: FmuIdentity,
    model: FmuModel,
    block: BlockText,
    scenario: Scenario,
    variables: list[FmuVariable],
) -> tuple[dict[str, bytes], FmuIdentity]:
    """Return all files of the FMU except the library, and the FMU's identity, whose token is a digest of these
    files."""
    texts = {
        f"sources/{block.name}.h": block.header,
        f"sources/{block.name}.c": block.source,
        **{
            f"sources/{n}": (SOURCES / n).read_text(encoding="utf-8")
            for n in ("fmu.h", f"fmi{version}.c", *HEADERS[version])
        },
    }
    said = [*texts.values(), description_xml(version, about, variables)]
    said.append(model_header(model, block, scenario, variables, ""))
    token = f"{{{UUID(bytes=sha256(chr(0).join(said).encode()).digest()[:16])}}}"
    about = about._replace(token=token)
    texts["modelDescription.xml"] = description_xml(version, about, variables)
    texts["sources/model.h"] = model_header(model, block, scenario, variables, token)
    if version == 3:
        texts["sources/buildDescription.xml"] = build_description_xml(about, " ".join(OPTIONS))
    return {n: t.encode() for n, t in texts.items()}, about


def find_platform(version: int) -> tuple[str, str]:
    """Return the name of the folder below `binaries` for this platform, and the suffix of the platform's shared
    libraries."""
    system, suffix = SYSTEMS.get(sys.platform, ("windows", ".dll"))
    machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    if version == 2 and machine == "x86_64":
        return {"linux": "linux64", "darwin": "darwin64", "windows": "win64"}[system], suffix
    return f"{machine}-{system}", suffix


def _compile(about: FmuIdentity, files: dict[str, bytes], block: BlockText) -> bytes | None:
    """Compile the sources and return the content of the shared library, or None if no compiler was found."""
    compiler = find_compiler("c")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory(prefix="trimtab-") as scratch:
        for name, text in files.items():
            if name.startswith("sources/"):
                (Path(scratch) / name.removeprefix("sources/")).write_bytes(text)
        flags = [*compiler.options, *OPTIONS, *block.flags]
        flags += ["-fvisibility=hidden", "-fPIC", "-shared"]
        command = [compiler.path, *flags, *about.sources, "-o", "model.so", "-lm"]
        built = subprocess.run(
            command, cwd=scratch, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
        )
        if built.returncode:
            said = "\n".join(built.stderr.splitlines()[:20])
            raise InputError("export --fmu", f"the compiler reported an error:\n{said}", fix="report this error")
        return (Path(scratch) / "model.so").read_bytes()


def _write_archive(path: Path, files: dict[str, bytes]) -> None:
    """Write a zip file whose bytes depend only on the names and contents of its files."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in sorted(files, key=lambda n: (n != "modelDescription.xml", n)):
                entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
                entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(entry, files[name])
    except OSError as error:
        problem = f"cannot write the file {str(path)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError(
            argument_name("out"),
            problem,
            fix=f"{argument_name('out')} with a file that you can write, e.g. {argument('out', 'autopilot.fmu')}",
        ) from None
