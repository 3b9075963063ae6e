"""Vehicle from another tool as a functional mock-up unit (FMU): a description and a program that steps the vehicle.

Reading the description runs no code. The program runs with all rights of the user, so it is loaded only if the user
declares that it is trusted.
Source: FMI 3.0.2 and FMI 2.0.5, Modelica Association, fmi-standard.org.
"""

import functools
import re
import shutil
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument, install_command
from trimtab.core.record import option, quantity, record, replace
from trimtab.core.signals import Motion, no_motion
from trimtab.core.suggestions import closest

KINDS = {"Float64": "real", "Float32": "real", "Real": "real", "Boolean": "flag", "UInt32": "word"}
KINDS |= dict.fromkeys(("Int8", "UInt8", "Int16", "UInt16", "Int32", "Integer", "Enumeration"), "count")
KINDS |= dict.fromkeys(("Int64", "UInt64"), "real")
"""Kind of quantity for each type of FMU variable. 64-bit integers are exact up to 2**53."""


class FmuSignal(NamedTuple):
    """Input, output or parameter of an FMU. field: name of the signal in trimtab's record."""

    name: str
    field: str
    type: str
    reference: int
    shape: tuple[int, ...]
    unit: str
    doc: str
    start: tuple[float, ...]

    @property
    def size(self) -> int:
        """Return the number of elements of the signal."""
        return int(np.prod(self.shape))


class FmuInterface(NamedTuple):
    """Content of an FMU's model description.

    duration_s, step_s: duration and step (s) of the FMU's default experiment, or None.
    """

    name: str
    version: str
    inputs: tuple[FmuSignal, ...]
    outputs: tuple[FmuSignal, ...]
    parameters: tuple[FmuSignal, ...]
    duration_s: float | None
    step_s: float | None


@record
class FmuVehicle:
    """FMU as a vehicle. The state record contains the FMU's outputs, the input record contains the FMU's inputs.

    Frames:  those of the FMU's author. `motion_of` assigns outputs to the fields of a `Motion`.
    Valid:   as stated by the FMU's author. Only the FMU's outputs are modelled. The derivative of the state is
             unknown, so the vehicle cannot be linearised.
    Source:  docs page, FMU.
    """

    file: str = option("Path of the FMU file.", default="")
    trust_code: bool = option(
        "True: the program in the FMU is trusted and may run with your rights.", default=False, choices=(True, False)
    )
    motion_of: tuple[tuple[str, str], ...] = option(
        'Pairs (component of the motion, output of the FMU), e.g. (("v_WB_B[0]", "speed"),). Other components are 0.',
        default=(),
    )
    settings: tuple[tuple[str, float], ...] = option(
        "Names and values of the FMU's parameters, set before the FMU starts.", default=()
    )
    digest: str = option("SHA-256 of the FMU file, recorded in logs.", default="")
    is_stepped: bool = option("True: the host program steps the FMU, so the loop does not integrate it.", default=False)

    MAV_TYPE: ClassVar[str] = "GENERIC"

    def check(self) -> None:
        """Raise InputError for an FMU that is not trusted."""
        if self.file and not self.trust_code:
            problem = f"{self.file!r} is a program: loading it runs its maker's code, with all your rights"
            trust = argument("settings", "yes", "trust_code")
            fix = f"if you trust its origin:  {trust}, or FmuVehicle(…, trust_code=True)"
            raise InputError("FMU", problem, fix=fix)

    def dynamics(self, t: Any, x: Any, u: Any) -> Any:
        """Return zero for an FMU that a host program steps.

        Otherwise raise InputError, as the derivative is unknown.
        """
        if not self.is_stepped:
            problem = "an FMU is a program that is called step by step, so it can't be compiled or differentiated"
            fix = "use trimtab run, vehicle or fly, which step an FMU. The other commands need a vehicle in Python"
            raise InputError("world.vehicle", problem, fix=fix)
        return jax.tree.map(jnp.zeros_like, x)

    def motion(self, t: Any, x: Any, u: Any) -> Motion:
        """Return the motion from the variables in `motion_of`, in the units and frames of a Motion."""
        motion = replace(no_motion(), t=t)
        for component, output in self.motion_of:
            name, index = _split_element(component)
            value = getattr(x, _split_element(output)[0])
            value = value if _split_element(output)[1] is None else value[_split_element(output)[1]]
            vector = jnp.asarray(getattr(motion, name))
            motion = replace(motion, **{name: vector.at[index].set(value) if index is not None else value})
        return motion


def load(
    file: str | Path,
    *,
    trust_code: bool = False,
    motion_of: Mapping[str, str] | None = None,
    settings: Mapping[str, float] | None = None,
) -> FmuVehicle:
    """Return an FMU as a vehicle. The program in the FMU is not run yet.

    Args:
        file: path of the FMU.
        trust_code: True if the program in the FMU may run later.
        motion_of: component of `core.signals.Motion` -> output, e.g. {"v_WB_B[0]": "speed"}; for sensors of the motion.
        settings: parameter of the FMU -> number.

    Raises:
        InputError: the file is not an FMU for co-simulation, an output or parameter is unknown, or fmpy is missing.
    """
    interface = read_interface(str(file))
    outputs = {s.name: s for s in interface.outputs}
    pairs = []
    for component, output in (motion_of or {}).items():
        name, index = _split_element(output)
        signal = _find_signal(outputs, name, f"FMU {str(file)!r}", "output")
        _check_component(component)
        pairs.append((component, signal.field if index is None else f"{signal.field}[{index}]"))
    known = {s.name: s for s in interface.parameters}
    for name in settings or {}:
        _find_signal(known, name, f"FMU {str(file)!r}", "parameter")
    return FmuVehicle(
        file=str(file),
        trust_code=trust_code,
        motion_of=tuple(pairs),
        settings=tuple((n, float(v)) for n, v in (settings or {}).items()),
        digest=sha256(Path(file).read_bytes()).hexdigest(),
    )


def first_state(vehicle: FmuVehicle) -> Any:
    """Return the record of the FMU's outputs, with the start values in the FMU's description, or zero where a start
    value is missing."""
    return _signal_record("FmuState", read_interface(vehicle.file).outputs)


def neutral_input(vehicle: FmuVehicle) -> Any:
    """Return the record of the FMU's inputs, with the start values in the FMU's description, or zero where a start
    value is missing."""
    return _signal_record("FmuInput", read_interface(vehicle.file).inputs)


@functools.lru_cache(maxsize=16)
def read_interface(file: str) -> FmuInterface:
    """Return the interface in the description of an FMU, without running its program.

    Raises: InputError: the file is not an FMU for co-simulation, or fmpy, which reads FMUs, is missing.
    """
    about = _read_description(file)
    if about.coSimulation is None:
        problem = "the FMU supports only model exchange, which has no integrator"
        raise InputError(f"FMU {file!r}", problem, fix="export the FMU from its tool for co-simulation")
    numbers = [v for v in about.modelVariables if v.type in KINDS and v.causality != "independent"]

    def signals(causalities: Iterable[str]) -> tuple[FmuSignal, ...]:
        return tuple(_signal(v) for v in numbers if v.causality in causalities)

    proposed = about.defaultExperiment
    stop, step = (getattr(proposed, n, None) if proposed else None for n in ("stopTime", "stepSize"))
    return FmuInterface(
        name=about.modelName,
        version=about.fmiVersion,
        inputs=signals(("input",)),
        outputs=signals(("output",)),
        parameters=signals(("parameter", "structuralParameter")),
        duration_s=None if stop is None else float(stop),
        step_s=None if step is None else float(step),
    )


def _read_description(file: str) -> Any:
    fmpy = import_fmpy()
    try:
        return fmpy.read_model_description(file, validate=False)
    except Exception as error:
        problem = (
            f"the file can't be read as an FMU: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
        )
        raise InputError(f"FMU {file!r}", problem, fix="give the path of an .fmu file for FMI 2.0 or 3.0") from None


def import_fmpy() -> Any:
    """Return the module fmpy, which reads and steps FMUs."""
    try:
        import fmpy
    except ModuleNotFoundError:
        raise InputError(
            "FMU", "the package fmpy, which reads and steps FMUs, is not installed", fix=install_command("fmu")
        ) from None
    return fmpy


def _signal(v: Any) -> FmuSignal:
    shape = tuple(int(d.start if d.start is not None else d.variable.start) for d in v.dimensions or ())
    texts = str(v.start).split() if v.start is not None else []
    numbers = [_parse(text) for text in texts] or [0.0]
    size = int(np.prod(shape))
    start = tuple(numbers if len(numbers) == size else numbers[:1] * size)
    unit = v.unit or (v.declaredType.unit if v.declaredType is not None else None) or "1"
    doc = " ".join((v.description or v.name).split())
    return FmuSignal(v.name, re.sub(r"\W", "_", v.name), v.type, v.valueReference, shape, unit, doc, start)


def _parse(text: str) -> float:
    return {"true": 1.0, "false": 0.0}.get(text) if text in ("true", "false") else float(text)  # pyright: ignore[reportReturnType]


def _signal_record(name: str, signals: tuple[FmuSignal, ...]) -> Any:
    kind = _signal_class(name, signals)
    return kind(**{s.field: np.reshape(np.asarray(s.start), s.shape)[()] for s in signals})


@functools.lru_cache(maxsize=32)
def _signal_class(name: str, signals: tuple[FmuSignal, ...]) -> Any:
    """Return a record class with one quantity for each signal."""
    fields = {s.field: quantity(s.unit, s.doc, kind=KINDS[s.type], shape=s.shape) for s in signals}
    if len(fields) < len(signals):
        twice = [s.name for s in signals if [o.field for o in signals].count(s.field) > 1]
        raise InputError(
            "FMU", f"the variables {twice} have the same name in trimtab", fix="rename one of them in the FMU"
        )
    return record(
        type(name, (), {"__annotations__": dict.fromkeys(fields, Any), "__doc__": "Signals of an FMU.", **fields})
    )


def _find_signal(known: Mapping[str, FmuSignal], name: str, part: str, kind: str) -> FmuSignal:
    if name not in known:
        near = closest(name, known, 6) or list(known)[:6]
        fix = f"name {near[0]!r}" if near else "leave it out"
        raise InputError(part, f"the FMU has no {kind} {name!r}", choices=near, fix=fix)
    return known[name]


def _split_element(text: str) -> tuple[str, int | None]:
    match = re.fullmatch(r"(.+)\[(\d+)\]", text)
    return (match[1], int(match[2])) if match else (text, None)


def _check_component(component: str) -> None:
    name, index = _split_element(component)
    motion = no_motion()
    vectors = [n for n in ("p_WB", "attitude", "v_WB_B", "w_WB_B", "a_WB_B", "alpha_WB_B") if hasattr(motion, n)]
    if name not in vectors or index is None or index > 2:
        choices = [f"{n}[{i}]" for n in vectors for i in range(3)]
        raise InputError(
            "FMU motion", f"a Motion has no component {component!r}", choices=choices, fix='motion_of={"v_WB_B[0]": …}'
        )


class FmuInstance:
    """Running FMU with methods to read its outputs, write its inputs and step it.

    Inputs and outputs are each passed as one flat list of numbers.
    """

    def __init__(self, vehicle: FmuVehicle) -> None:
        """Unpack, load and initialise the FMU. This runs the program in the FMU.

        Raise InputError for an FMU that is not trusted.
        """
        vehicle.check()
        fmpy, self.vehicle, self.file = import_fmpy(), vehicle, vehicle.file
        about, interface = _read_description(vehicle.file), read_interface(vehicle.file)
        self._folder = fmpy.extract(vehicle.file)
        self._is_old = about.fmiVersion.startswith("2")
        known = {s.name: s for s in interface.parameters}
        try:
            self._fmu = fmpy.instantiate_fmu(self._folder, about, "CoSimulation")
            for name, value in vehicle.settings:
                self._set(known[name], [value])
            if self._is_old:
                self._fmu.setupExperiment(startTime=0.0)
            self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
        except Exception as error:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise InputError(f"FMU {self.file!r}", f"the FMU does not start: {error}", fix=_PLATFORM_FIX) from None
        self._inputs, self._outputs = interface.inputs, interface.outputs
        self.t = 0
        """Simulated time of the FMU (100 ns)."""

    def read(self) -> list[float]:
        """Return all outputs of the FMU as a flat list, in the order of the state record."""
        return [float(x) for s in self._outputs for x in self._get(s)]

    def write(self, values: Any) -> None:
        """Write all inputs of the FMU from a flat list, in the order of the input record."""
        at = 0
        for s in self._inputs:
            self._set(s, values[at : at + s.size])
            at += s.size

    def step(self, h: int) -> bool:
        """Step the FMU by a time h (unit: 100 ns) with constant inputs.

        Return True if the FMU requests the end of the simulation. Raise InputError if the step fails.
        """
        t, length = self.t * 1e-7, (self.t + h) * 1e-7 - self.t * 1e-7
        try:
            answer = self._fmu.doStep(currentCommunicationPoint=t, communicationStepSize=length)
        except Exception as error:
            if self._is_old and self._fmu.getBooleanStatus(TERMINATED):
                self.t += h
                return True
            problem = f"the FMU refused a step of {length:g} s at {t:g} s: {error}"
            fix = (
                f"try another {argument('settings', '…', 'world.max_step')}; the FMU may accept only certain step sizes"
            )
            raise InputError(f"FMU {self.file!r}", problem, fix=fix) from None
        _, is_over, is_early, reached = answer or (False, False, False, 0.0)
        if is_early and not is_over:
            problem = f"the FMU stopped at {reached:g} s, within a step, which is not allowed"
            raise InputError(f"FMU {self.file!r}", problem, fix="report this to the maker of the FMU")
        self.t += h
        return bool(is_over)

    def close(self) -> None:
        """Terminate the FMU, and remove its unpacked files."""
        try:
            self._fmu.terminate()
            self._fmu.freeInstance()
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _get(self, s: FmuSignal) -> Any:
        read = getattr(self._fmu, f"get{self._type(s)}")
        return read([s.reference]) if self._is_old else read([s.reference], s.size)

    def _set(self, s: FmuSignal, values: Any) -> None:
        numbers = [bool(v) if s.type == "Boolean" else float(v) if s.type in _REAL else int(v) for v in values]
        getattr(self._fmu, f"set{self._type(s)}")([s.reference], numbers)

    def _type(self, s: FmuSignal) -> str:
        return s.type if s.type != "Enumeration" else "Integer" if self._is_old else "Int64"


TERMINATED = 3
"""Value of fmi2StatusKind in FMI 2.0 that asks whether the FMU requests the end of the simulation."""
_REAL = ("Float64", "Float32", "Real")
_PLATFORM_FIX = "use an FMU with a binary for this machine, and parameter values that the FMU accepts"
