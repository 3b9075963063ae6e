"""export_fmu: other importers accept the FMU, and their flight is bit-identical to the simulated scenario."""

import re
import subprocess
import zipfile
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from trimtab.compiler.identifiers import identifier
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.export.fmu import FMU_PARTS, OPTIONS, export_fmu
from trimtab.export.fmu_description import unit_in_si
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
NAME = "cart-pole/swing-up"
NAMES = [name for name in catalogue.scenario_names() if not name.startswith("swarm/")]
"""A swarm's autopilots hear of each other what no variable shows."""


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """(part, version) -> an FMU of NAME, exported when it is asked for."""
    folder, scenario = tmp_path_factory.mktemp("fmus"), build(NAME)

    class Fmus(dict):
        def __missing__(self, kind):
            part, version = kind
            self[kind] = export_fmu(scenario, folder / f"{part}{version}.fmu", part=part, version=version).path
            return self[kind]

    return Fmus()


class Instance:
    """An FMU in fmpy, its variables by name."""

    def __init__(self, path, before=None, start=0.0):
        about = fmpy.read_model_description(path)
        self.fmu = fmpy.instantiate_fmu(fmpy.extract(path), about, "CoSimulation")
        self.old = about.fmiVersion == "2.0"
        self.variables = {v.name: v for v in about.modelVariables}
        self.begin(before or {}, start)

    def begin(self, before, start=0.0):
        for name, value in before.items():
            self.set(name, value)
        if self.old:
            self.fmu.setupExperiment(startTime=start)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start)
        self.fmu.exitInitializationMode()

    def named(self, causality):
        return [n for n, v in self.variables.items() if v.causality == causality]

    def get(self, name):
        v = self.variables[name]
        read = getattr(self.fmu, f"get{v.type}")
        if self.old:
            return np.array(read([v.valueReference]), float)
        return np.array(read([v.valueReference], int(np.prod([int(d.start) for d in v.dimensions]))), float)

    def set(self, name, value):
        v = self.variables[name]
        kind = {"Boolean": bool, "Integer": int, "Int32": int, "Int64": int, "UInt32": int}.get(v.type, float)
        getattr(self.fmu, f"set{v.type}")([v.valueReference], [kind(x) for x in np.ravel(value)])

    def outputs(self):
        return np.concatenate([self.get(n) for n in self.named("output")])


def logged(log, name, k):
    """A variable's value in a log's row k."""
    element = re.fullmatch(r"(.*)\[(\d+)\]", name)
    paths = {".".join(map(identifier, p.split("."))): p for p in log.paths}
    value = np.ravel(np.asarray(log[paths[element[1] if element else name]][k], float))
    return value[[int(element[2])]] if element else value


def off(instance, names, log, k):
    """The variables whose value isn't that of the log, to the bit."""
    return [n for n in names if not np.array_equal(instance.get(n), logged(log, n, k), equal_nan=True)]


def fly_coupled(scenario, autopilot, vehicle, loop, steps):
    """Fly two FMUs wired to each other, a loop beside them, and count what is not as we simulated it."""
    period = scenario.autopilot.period
    log = simulate(scenario, duration=(steps + 1) * period, log_period=period, backend="c")
    h = period * 1e-7
    now = ("truth.", "sensors.", "downlink.")  # the rest tells of the step up to now
    seen = [n for n in vehicle.named("output") if n.startswith(now)]
    assert seen
    assert vehicle.named("input")
    assert autopilot.named("input")
    for k in range(steps):
        assert off(loop, loop.named("output"), log, k) == []
        assert off(vehicle, seen, log, k) == []
        for name in autopilot.named("input"):
            autopilot.set(name, vehicle.get(name))
        autopilot.fmu.doStep(k * h, h)
        assert off(autopilot, autopilot.named("output"), log, k) == []
        for name in vehicle.named("input"):
            vehicle.set(name, autopilot.get(name))
        vehicle.fmu.doStep(k * h, h)
        loop.fmu.doStep(k * h, h)


SLOW_2 = pytest.param(2, marks=pytest.mark.thorough)


@pytest.mark.thorough
@pytest.mark.parametrize("version", [SLOW_2, 3])
def test_fmpy_flight_is_bit_identical(fmus, version):
    parts = [Instance(fmus[part, version]) for part in FMU_PARTS]
    assert len(parts[0].named("output")) > 10
    fly_coupled(build(NAME), *parts, steps=120)


@pytest.mark.thorough
@pytest.mark.parametrize("part", FMU_PARTS)
@pytest.mark.parametrize("version", [SLOW_2, 3])
def test_fmu_passes_schema_validation(fmus, part, version):
    assert validate_fmu(str(fmus[part, version])) == []


@pytest.mark.thorough
def test_validation_detects_an_undefined_unit(fmus, tmp_path):
    with zipfile.ZipFile(fmus["autopilot", 3]) as archive:
        text = archive.read("modelDescription.xml").decode()
    (tmp_path / "modelDescription.xml").write_text(text.replace('unit="m"', 'unit="ell"'))
    assert any("ell" in problem for problem in validate_fmu(str(tmp_path)))


@pytest.mark.thorough("3")
@pytest.mark.parametrize("version", [2, 3])
def test_fmu_sources_compile_without_warnings(fmus, version, tmp_path):
    with zipfile.ZipFile(fmus["loop", version]) as archive:
        archive.extractall(tmp_path)
        listed = archive.read("sources/buildDescription.xml") if version == 3 else archive.read("modelDescription.xml")
    tree = ET.fromstring(listed)
    files = [e.get("name") for e in tree.iter("SourceFile" if version == 3 else "File")]
    options = next(tree.iter("SourceFileSet")).get("compilerOptions").split() if version == 3 else [*OPTIONS]
    strict = ["-pedantic", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    done = subprocess.run(
        [find_compiler("c").path, *options, *strict, *files], cwd=tmp_path / "sources", capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.thorough
def test_two_fmus_can_be_linked_from_source(fmus, tmp_path):
    objects = []
    for part in ("autopilot", "vehicle"):
        with zipfile.ZipFile(fmus[part, 3]) as archive:
            archive.extractall(tmp_path / part)
        for file in (tmp_path / part / "sources").glob("*.c"):
            objects.append(tmp_path / f"{part}-{file.stem}.o")
            prefix = [f"-DFMI3_FUNCTION_PREFIX={part}_", "-O0", "-c", file, "-o", objects[-1]]
            subprocess.run([find_compiler("c").path, *prefix], check=True)
    main = tmp_path / "main.c"
    main.write_text(
        "const char *autopilot_fmi3GetVersion(void), *vehicle_fmi3GetVersion(void);\n"
        "int main(void) { return !(autopilot_fmi3GetVersion()[0] == '3' && vehicle_fmi3GetVersion()[0] == '3'); }\n"
    )
    subprocess.run([find_compiler("c").path, main, *objects, "-o", tmp_path / "main", "-lm"], check=True)
    assert subprocess.run([tmp_path / "main"]).returncode == 0


@pytest.mark.parametrize("version", [2, 3])
def test_restored_state_continues_identically(fmus, version):
    one, other = Instance(fmus["loop", version]), Instance(fmus["loop", version])
    one.fmu.doStep(0.0, 0.5)
    get, put = ("getFMUstate", "setFMUstate") if version == 2 else ("getFMUState", "setFMUState")
    state, there = getattr(one.fmu, get)(), one.outputs()
    one.fmu.doStep(0.5, 0.5)
    after = one.outputs()
    assert not np.array_equal(after, there)
    getattr(one.fmu, put)(state)
    assert np.array_equal(one.outputs(), there)
    one.fmu.doStep(0.5, 0.5)
    assert np.array_equal(one.outputs(), after)
    serialize, restore = ("serializeFMUstate", "deSerializeFMUstate")
    serialize, restore = (serialize, restore) if version == 2 else ("serializeFMUState", "deserializeFMUState")
    saved = getattr(one.fmu, serialize)(state)
    getattr(other.fmu, put)(getattr(other.fmu, restore)(saved))
    other.fmu.doStep(0.5, 0.5)
    assert np.array_equal(other.outputs(), after)


def test_instances_are_independent_and_can_be_reset(fmus):
    one, other = Instance(fmus["loop", 3]), Instance(fmus["loop", 3], {"initial.angle": 3.0})
    first = one.outputs()
    for k in range(50):
        one.fmu.doStep(k * 0.01, 0.01)
        other.fmu.doStep(k * 0.01, 0.01)
    flown = one.outputs()
    assert not np.array_equal(flown, other.outputs())
    one.fmu.terminate()
    one.fmu.reset()
    one.begin({})
    assert np.array_equal(one.outputs(), first)
    one.fmu.doStep(0.0, 0.5)  # one long step passes the same instants
    assert np.array_equal(one.outputs(), flown)


def test_fmu_can_start_at_any_time(fmus):
    one, late = Instance(fmus["loop", 3]), Instance(fmus["loop", 3], start=100.0)
    one.fmu.doStep(0.0, 0.3)
    late.fmu.doStep(100.0, 0.3)
    assert np.array_equal(one.outputs(), late.outputs())
    assert late.get("time") == pytest.approx(100.3)


def test_fmu_parameter_equals_scenario_setting(fmus):
    path = "world.vehicle.pole_mass"
    scenario = build(NAME, {path: "0.3"})
    log = simulate(scenario, duration=scenario.autopilot.period * 200, log_period=scenario.autopilot.period)
    one = Instance(fmus["loop", 3], {path: 0.3})
    h = scenario.autopilot.period * 1e-7
    for k in range(199):
        one.fmu.doStep(k * h, h)
    assert off(one, one.named("output"), log, 199) == []
    assert one.variables[path].variability == "tunable"
    assert one.variables["initial.angle"].variability == "fixed"


def test_rejects_out_of_range_and_fixed_parameters(fmus):
    one = Instance(fmus["loop", 3])
    mass = one.variables["world.vehicle.pole_mass"]
    assert float(mass.min) == 0.0
    assert mass.unit == "kg"
    one.set("world.vehicle.pole_mass", 0.2)
    for name, value in [("world.vehicle.pole_mass", 0.0), ("world.vehicle.pole_mass", np.nan), ("initial.angle", 3.0)]:
        with pytest.raises(Exception, match=r"fmi3Error|status"):
            one.set(name, value)
    assert one.get("world.vehicle.pole_mass") == 0.2
    with pytest.raises(Exception, match=r"fmi3Error|status"):
        one.fmu.doStep(3.0, 0.1)


def test_message_without_a_time_counts_as_current(fmus):
    """Wiring only the values gives the same as wiring values and times, where nothing is late."""
    scenario = build(NAME)
    h = scenario.autopilot.period * 1e-7
    vehicle, whole, bare = Instance(fmus["vehicle", 3]), *(Instance(fmus["autopilot", 3]) for _ in range(2))
    values = [n for n in bare.named("input") if ".value." in n]
    assert 0 < len(values) < len(bare.named("input"))
    commands = [n for n in vehicle.named("input") if ".value." in n]
    for k in range(80):
        for name in whole.named("input"):
            whole.set(name, vehicle.get(name))
        for name in values:
            bare.set(name, vehicle.get(name))
        whole.fmu.doStep(k * h, h)
        bare.fmu.doStep(k * h, h)
        for name in commands:
            assert np.array_equal(whole.get(name), bare.get(name))
            vehicle.set(name, whole.get(name))
        vehicle.fmu.doStep(k * h, h)


def test_libcosim_flight_is_bit_identical(fmus):
    """libcosim, which reads FMUs by Modelon's FMI Library."""
    pytest.importorskip("libcosimpy")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.ERROR)
    scenario = build(NAME)
    period = scenario.autopilot.period
    log = simulate(scenario, duration=period * 200, log_period=period, backend="c")
    execution = CosimExecution.from_step_size(step_size=period * 100)
    slave = execution.add_local_slave(CosimLocalSlave(fmu_path=str(fmus["loop", 2]), instance_name="loop"))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    at = {v.name.decode(): v.reference for v in execution.slave_variables(slave_index=slave)}
    names = ["truth.position", "truth.angle", "truth.angle_rate", "actuators.u.force"]
    for k in range(1, 199):
        execution.step()
        got = observer.last_real_values(slave_index=slave, variable_references=[at[n] for n in names])
        assert list(got) == [float(logged(log, n, k)[0]) for n in names]


def test_units_are_converted_to_si():
    assert unit_in_si("kg m^2") == (1.0, {"kg": 1, "m": 2})
    assert unit_in_si("N s^2/m^2") == (1.0, {"kg": 1, "m": -1})
    assert unit_in_si("1/s") == (1.0, {"s": -1})
    assert unit_in_si("100 ns") == (pytest.approx(1e-7), {"s": 1})
    assert unit_in_si("N/krpm^2")[0] == pytest.approx((2e3 * np.pi / 60) ** -2)
    assert unit_in_si("slug/ft^3")[0] == pytest.approx(515.378818)
    assert unit_in_si("rad/s/Hz^0.5") is None
    assert unit_in_si("kg/(m rad)") is None
    assert unit_in_si("row") is None


def test_repeated_export_gives_an_identical_file(fmus, tmp_path):
    again = export_fmu(build(NAME), tmp_path / "again.fmu", part="autopilot", version=3)
    assert again.path.read_bytes() == fmus["autopilot", 3].read_bytes()


def test_rejects_unknown_part_version_and_path(tmp_path):
    with pytest.raises(InputError, match='part="autopilot"'):
        export_fmu(build(NAME), tmp_path / "x.fmu", part="radio")
    with pytest.raises(InputError, match="fmu=3"):
        export_fmu(build(NAME), tmp_path / "x.fmu", version=1)
    with pytest.raises(InputError, match="out"):
        export_fmu(build(NAME), tmp_path)


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_every_scenario_flies_bit_identically_as_fmus(name, tmp_path):
    scenario, _ = catalogue.load_scenario(name)
    parts = []
    for part in FMU_PARTS:
        path = export_fmu(scenario, tmp_path / f"{part}.fmu", part=part, version=3).path
        assert validate_fmu(str(path)) == []
        parts.append(Instance(path))
    fly_coupled(scenario, *parts, steps=250)
