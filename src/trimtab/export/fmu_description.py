"""Generator of the file modelDescription.xml of an FMU, for FMI 2.0 and 3.0: units, ranges, and tunable or fixed
parameters.

Source: FMI 3.0.2 and FMI 2.0.5, Modelica Association, fmi-standard.org.
"""

import math
import re
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from trimtab import __version__
from trimtab.export.fmu_model import FmuVariable

TYPES_3 = {"f64": "Float64", "f32": "Float32", "i32": "Int32", "i64": "Int64", "u32": "UInt32", "bool": "Boolean"}
TYPES_2 = {"f64": "Real", "f32": "Real", "i32": "Integer", "i64": "Real", "u32": "Real", "bool": "Boolean"}
BASE: dict[str, tuple[float, dict[str, int]]] = {
    "kg": (1.0, {"kg": 1}),
    "m": (1.0, {"m": 1}),
    "s": (1.0, {"s": 1}),
    "A": (1.0, {"A": 1}),
    "K": (1.0, {"K": 1}),
    "rad": (1.0, {"rad": 1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "Hz": (1.0, {"s": -1}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "T": (1.0, {"kg": 1, "s": -2, "A": -1}),
    "ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "rpm": (2 * math.pi / 60, {"rad": 1, "s": -1}),
    "krpm": (2e3 * math.pi / 60, {"rad": 1, "s": -1}),
    "ns": (1e-9, {"s": 1}),
    "ft": (0.3048, {"m": 1}),
    "lbf": (4.4482216152605, {"kg": 1, "m": 1, "s": -2}),
    "slug": (14.593902937206, {"kg": 1}),
}
"""Factor from each unit to SI units, and exponents of the SI base units, by the unit's name."""


class FmuIdentity(NamedTuple):
    """Description of an FMU. sources: names of the C files to compile."""

    scenario: str
    part: str
    identifier: str
    doc: str
    token: str
    duration_s: float
    step_s: float
    sources: tuple[str, ...]


def description_xml(version: int, about: FmuIdentity, variables: list[FmuVariable]) -> str:
    """Return the text of modelDescription.xml. The value references of the variables are 1, 2, …, in the order of the
    variables."""
    root = ET.Element("fmiModelDescription", fmiVersion="3.0" if version == 3 else "2.0")
    root.set("modelName", f"{about.scenario} {about.part}")
    root.set("instantiationToken" if version == 3 else "guid", about.token)
    root.attrib |= {
        "description": about.doc,
        "version": __version__,
        "generationTool": f"trimtab {__version__}",
        "variableNamingConvention": "structured",
    }
    kind = ET.SubElement(root, "CoSimulation", modelIdentifier=about.identifier)
    state = "FMUState" if version == 3 else "FMUstate"
    flags = ("canHandleVariableCommunicationStepSize", f"canGetAndSet{state}", f"canSerialize{state}")
    kind.attrib |= dict.fromkeys(flags, "true")
    if version == 2:
        files = ET.SubElement(kind, "SourceFiles")
        for name in about.sources:
            ET.SubElement(files, "File", name=name)
    _add_units(root, version, variables)
    ET.SubElement(ET.SubElement(root, "LogCategories"), "Category", name="logStatusError")
    times = {"startTime": "0", "stopTime": f"{about.duration_s:.10g}", "stepSize": f"{about.step_s:.10g}"}
    ET.SubElement(root, "DefaultExperiment", times)
    held = ET.SubElement(root, "ModelVariables")
    if version == 3:
        independent = {"name": "time", "valueReference": "0", "causality": "independent", "variability": "continuous"}
        ET.SubElement(held, "Float64", independent | {"description": "Simulated time (s)."})
    for reference, v in enumerate(variables, 1):
        (_add_variable_3 if version == 3 else _add_variable_2)(held, v, reference)
    _add_structure(root, version, variables)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def build_description_xml(about: FmuIdentity, options: str) -> str:
    """Return the text of sources/buildDescription.xml, as FMI 3.0 defines it."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    built = ET.SubElement(root, "BuildConfiguration", modelIdentifier=about.identifier)
    files = ET.SubElement(built, "SourceFileSet", language="C99", compiler="gcc", compilerOptions=options)
    for name in about.sources:
        ET.SubElement(files, "SourceFile", name=name)
    ET.SubElement(built, "Library", name="m", description="Mathematics of C", external="true")
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def unit_in_si(unit: str) -> tuple[float, dict[str, int]] | None:
    """Return the factor from a unit to SI and the exponents of the SI base units, or None if FMI cannot express the
    unit, e.g. the square root of a unit."""
    factor, exponents, sign = 1.0, dict[str, int](), 1
    if match := re.fullmatch(r"(\d+) (.*)", unit):
        factor, unit = float(match[1]), match[2]
    for token in re.findall(r"[^\s/]+|/", unit):
        if token == "/":
            sign = -1
            continue
        name, _, power = token.partition("^")
        if (name != "1" and name not in BASE) or not re.fullmatch(r"\d*", power):
            return None
        if name != "1":
            size, base = BASE[name]
            power = sign * int(power or 1)
            factor *= size**power
            for symbol, exponent in base.items():
                exponents[symbol] = exponents.get(symbol, 0) + exponent * power
        sign = 1
    return factor, {s: e for s, e in exponents.items() if e}


def _add_units(root: ET.Element, version: int, variables: list[FmuVariable]) -> None:
    units = sorted({u for v in variables if (u := _unit(v, version))})
    if not units:
        return
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in units:
        unit = ET.SubElement(definitions, "Unit", name=name)
        if (size := unit_in_si(name)) is not None:
            factor, exponents = size
            numbers = {s: str(e) for s, e in exponents.items()}
            ET.SubElement(unit, "BaseUnit", numbers | ({"factor": repr(factor)} if factor != 1.0 else {}))


def _unit(v: FmuVariable, version: int) -> str:
    """Return the declared unit of a real variable, or "" for integers, flags and variables without a unit."""
    is_real = (TYPES_3 if version == 3 else TYPES_2)[v.dtype] in ("Float64", "Float32", "Real")
    d = v.member.declaration
    return d.unit if d is not None and is_real and d.unit not in ("", "1") else ""


def _describe(v: FmuVariable) -> str:
    d = v.member.declaration
    if d is None:
        return ""
    unit = f" ({d.unit})" if d.unit not in ("", "1") else ""
    frame = f" Frame {d.frame}." if d.frame else ""
    modes = f" {', '.join(f'{i} {n}' for i, n in enumerate(d.modes))}." if d.modes else ""
    return f"{d.doc}{unit}{frame}{modes}".replace("\n", " ")


def _attributes(v: FmuVariable, reference: int) -> dict[str, str]:
    text = _describe(v)
    causality, variability = ("parameter", v.role) if v.role in ("fixed", "tunable") else (v.role, "discrete")
    named = {"name": v.name, "valueReference": str(reference)}
    named |= {"description": text} if text else {}
    return named | {"causality": causality, "variability": variability}


def _limits(v: FmuVariable, version: int) -> dict[str, str]:
    """Return the XML attributes unit, min and max of a variable. Outputs and integers have no min and max."""
    unit, d = _unit(v, version), v.member.declaration
    told = {"unit": unit} if unit else {}
    if d is None or v.role == "output" or v.dtype[0] != "f":
        return told
    low = d.low if d.above is None else d.above
    told |= {"min": repr(float(low))} if low is not None and math.isfinite(low) else {}
    return told | ({"max": repr(float(d.high))} if d.high is not None and math.isfinite(d.high) else {})


def _add_variable_3(held: ET.Element, v: FmuVariable, reference: int) -> None:
    attributes = _attributes(v, reference) | ({"initial": "calculated"} if v.role == "output" else {})
    attributes |= _limits(v, 3)
    if v.start is not None:
        attributes["start"] = " ".join(_number(x, v.dtype) for x in np.ravel(v.start))
    element = ET.SubElement(held, TYPES_3[v.dtype], attributes)
    for size in v.shape:
        ET.SubElement(element, "Dimension", start=str(size))


def _add_variable_2(held: ET.Element, v: FmuVariable, reference: int) -> None:
    attributes = _attributes(v, reference) | ({"initial": "calculated"} if v.role == "output" else {})
    scalar = ET.SubElement(held, "ScalarVariable", attributes)
    kind = ET.SubElement(scalar, TYPES_2[v.dtype], _limits(v, 2))
    if v.start is not None:
        kind.set("start", _number(v.start, v.dtype if TYPES_2[v.dtype] != "Real" else "f64"))


def _number(value: Any, dtype: str) -> str:
    if dtype == "bool":
        return str(bool(value)).lower()
    if dtype[0] != "f":
        return str(int(value))
    number = float(value)
    if math.isfinite(number):
        return repr(number)
    return "NaN" if math.isnan(number) else "INF" if number > 0 else "-INF"


def _add_structure(root: ET.Element, version: int, variables: list[FmuVariable]) -> None:
    outputs = [i for i, v in enumerate(variables, 1) if v.role == "output"]
    structure = ET.SubElement(root, "ModelStructure")
    if version == 3:
        for name in ("Output", "InitialUnknown"):
            for i in outputs:
                ET.SubElement(structure, name, valueReference=str(i))
        return
    for name in ("Outputs", "InitialUnknowns"):
        if outputs:
            unknowns = ET.SubElement(structure, name)
            for i in outputs:
                ET.SubElement(unknowns, "Unknown", index=str(i))
