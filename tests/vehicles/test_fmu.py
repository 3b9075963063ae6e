"""FMUs as vehicles: the Reference-FMUs against fmpy and against published output, and an FMU in closed loop."""

import threading
import zipfile
from typing import Any, ClassVar

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from flight.pair import fly_pair
from flight.transports.ends import free_port
from vehicles.reference import build_reference, reference_rows

from trimtab.actuators.allocation import DirectActuation
from trimtab.cli import main
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import part, period, record, replace
from trimtab.core.signals import new_sample
from trimtab.core.time import ms, seconds
from trimtab.export.fmu import export_fmu
from trimtab.flight.injector import add_idle_faults
from trimtab.flight.lockstep import LockstepAutopilot, LockstepVehicle
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.transports.open_link import open_link
from trimtab.flight.vehicle import LiveVehicle
from trimtab.logs.mcap import read_mcap
from trimtab.run.cosimulation import SteppedWorld
from trimtab.run.simulate import compile_scenario, simulate
from trimtab.scenarios.build import build
from trimtab.vehicles.cart_pole import CartPoleState
from trimtab.vehicles.fmu import FmuInstance, first_state, load, neutral_input, read_interface

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
TRUST = {"trust_code": "yes"}
MODELS = ("Dahlquist", "VanDerPol", "BouncingBall", "Stair", "Feedthrough")
HERE = {("Dahlquist", 3), ("Stair", 2)}
ALL = [(name, version) for name in MODELS for version in (3, 2)]
BOTH = [b if b in HERE else pytest.param(*b, marks=pytest.mark.thorough) for b in ALL]


@pytest.mark.thorough("Dahlquist-3")
@pytest.mark.parametrize(("name", "version"), BOTH)
def test_simulation_matches_fmpy_bit_for_bit(name, version, tmp_path):
    file = build_reference(name, version, tmp_path)
    scenario = build(str(file), TRUST)
    step = scenario.world.max_step
    log = simulate(scenario, log_period=step)
    options = {"step_size": step * 1e-7, "output_interval": step * 1e-7, "stop_time": scenario.duration * 1e-7}
    theirs = fmpy.simulate_fmu(str(file), fmi_type="CoSimulation", use_event_mode=False, **options)
    names = [n for n in theirs.dtype.names if f"truth.{n}" in log.paths]
    assert len(names) == len(read_interface(str(file)).outputs) > 0
    for n in names:
        assert np.array_equal(np.asarray(log[f"truth.{n}"], float), np.asarray(theirs[n], float)[: len(log)])
        assert log.final[f"truth.{n}"] == theirs[n][len(log)]
    assert ("ended_s" in log.metadata) == (name == "Stair")


@pytest.mark.parametrize(
    "name",
    ["Dahlquist", *(pytest.param(n, marks=pytest.mark.thorough) for n in ("VanDerPol", "BouncingBall", "Stair"))],
)
def test_simulation_matches_published_reference_output(name, tmp_path):
    header, *rows = reference_rows(name)
    table = np.array([[float(x) for x in row.split(",")] for row in rows])
    file = build_reference(name, 3, tmp_path)
    scenario = build(str(file), TRUST)
    step = round(table[1, 0] * 1e7)
    world = replace(scenario.world, max_step=step)
    log = simulate(replace(scenario, world=world, duration=round(table[-1, 0] * 1e7)), log_period=step)
    for k, signal in enumerate(header.split(",")[1:], 1):
        assert log[f"truth.{signal}"] == pytest.approx(table[: len(log), k], rel=1e-12, abs=1e-12)


@pytest.mark.thorough
def test_model_description_defines_signals_and_motion(tmp_path):
    file = build_reference("BouncingBall", 3, tmp_path)
    vehicle = load(file, motion_of={"p_WB[2]": "h", "v_WB_B[2]": "v"})
    log_names = [s.name for s in read_interface(str(file)).outputs]
    state = first_state(vehicle)
    assert log_names[:2] == ["h", "v"]
    assert (float(state.h), float(state.v)) == (1.0, 0.0)
    motion = vehicle.motion(0, replace(state, h=np.float64(0.25), v=np.float64(-2.0)), None)
    assert np.asarray(motion.p_WB).tolist() == [0.0, 0.0, 0.25]
    assert np.asarray(motion.v_WB_B).tolist() == [0.0, 0.0, -2.0]


@pytest.mark.thorough
def test_parameters_and_inputs_reach_the_fmu(tmp_path):
    ball = build_reference("BouncingBall", 3, tmp_path)
    scenario = build(str(ball), TRUST)
    free = replace(scenario, world=replace(scenario.world, vehicle=load(ball, trust_code=True, settings={"g": -1.0})))
    log = simulate(replace(free, duration=seconds(0.5)), log_period=ms(10))
    assert log["truth.v"][10] == pytest.approx(-0.1)
    through = build_reference("Feedthrough", 3, tmp_path)
    path = "autopilot.law.u0.Float64_continuous_input"
    log = simulate(build(str(through), TRUST | {path: "steps(0 s: 1, 0.5 s: 3)"}), log_period=ms(100))
    given = log["actuators.u.Float64_continuous_input"]
    assert sorted(set(given)) == [1.0, 3.0]
    assert np.array_equal(log["truth.Float64_continuous_output"][1:], given[:-1])


@record
class FmuEncoders:
    """Reads of the FMU what its own encoders say."""

    period: int = period("Time between samples.", default=ms(10))
    FEELS: ClassVar[str] = "state"

    def init(self, key):
        return ()

    def measure(self, x):
        return CartPoleState(*(getattr(x, f"downlink_encoders_value_{n}") for n in NAMES))

    def step(self, t, state, x):
        return state, new_sample(t, self.measure(x))


NAMES = ("position", "speed", "angle", "angle_rate")


@record
class FmuAllocation:
    """The wanted force as the FMU's command, which is one of now."""

    neutral: Any = part("The FMU's input.")

    def init(self, key):
        return ()

    def step(self, t, state, demand):
        return state, replace(self.neutral, command_value_force=demand.force, command_t=1.0 * t)


def flown_fmu(folder, duration):
    """The cart-pole's scenario, and the same with the vehicle as an FMU."""
    own = build("cart-pole/swing-up", {"duration": str(duration)})
    file = export_fmu(own, folder / "cart.fmu", part="vehicle", version=3).path
    vehicle = load(file, trust_code=True)
    actuators = DirectActuation(neutral_input(vehicle), period=ms(10))
    world = replace(own.world, vehicle=vehicle, sensors={"encoders": FmuEncoders()}, actuators=actuators)
    autopilot = replace(own.autopilot, allocation=FmuAllocation(neutral_input(vehicle)))
    return own, replace(own, world=world, autopilot=autopilot, initial=first_state(vehicle))


@pytest.mark.thorough
def test_closed_loop_with_fmu_is_bit_identical(tmp_path):
    own, flown = flown_fmu(tmp_path, 4)
    ours, log = simulate(own, log_period=ms(10), backend="c"), simulate(flown, log_period=ms(10))
    for n in NAMES:
        assert np.array_equal(log[f"truth.truth_{n}"], ours[f"truth.{n}"])
        assert np.ptp(ours[f"truth.{n}"]) > 0.1


@pytest.mark.real_time
def test_lockstep_flight_matches_simulation(tmp_path):
    _, flown = flown_fmu(tmp_path, 1)
    key, name = passphrase_key("correct-horse-battery-staple"), f"loopback://{tmp_path.name}"
    vehicle = LockstepVehicle(flown, lambda d: Endpoint(d, 1, 1, key))
    pilot = LockstepAutopilot(flown, lambda d: Endpoint(d, 1, 191, key))
    there, here = open_link(name, listen=True), open_link(name)
    leading = threading.Thread(target=vehicle.run, args=(there, tmp_path / "vehicle.mcap"))
    leading.start()
    try:
        pilot.run(here, tmp_path / "flight.mcap")
        leading.join()
    finally:
        here.close()
        there.close()
    log, simulated = read_mcap(tmp_path / "vehicle.mcap"), simulate(flown, log_period=ms(10))
    rows = np.searchsorted(simulated.ticks, log.ticks)
    for path in [f"truth.truth_{n}" for n in NAMES]:
        assert len(log[path]) > 90
        assert np.array_equal(log[path], simulated[path][rows])


def live_vehicle(file, folder, link, **settings):
    key = passphrase_key("correct-horse-battery-staple")
    scenario = build(str(file), TRUST | settings, in_virtual_time=False)
    return LiveVehicle(add_idle_faults(scenario), link, lambda dialect: Endpoint(dialect, 1, 1, key))


@pytest.fixture
def line(tmp_path):
    link = open_link(f"loopback://{tmp_path.name}", listen=True)
    yield link
    link.close()


@pytest.mark.real_time
def test_measuring_step_time_leaves_the_state_unchanged(tmp_path):
    world = SteppedWorld(build(str(build_reference("VanDerPol", 3, tmp_path)), TRUST))
    assert 0 < world.measure_steps(ms(10)) < 0.1
    for first in (True, False):
        world.inputs[world.reads["h"]], world.inputs[world.reads["first"]] = 0 if first else ms(10), first
        world.step()
        assert bool(world.outputs[world.writes["truth.x1"]] == 0.0) is first


@pytest.mark.real_time
def test_rejects_fmu_too_slow_for_real_time(tmp_path, line):
    file = build_reference("VanDerPol", 3, tmp_path)
    with pytest.raises(InputError, match=r"a step of the FMU takes .* ms here, too long for a step every 0.01 ms"):
        live_vehicle(file, tmp_path, line, **{"world.max_step": "10 us"})


@pytest.mark.real_time
def test_failed_step_ends_the_flight_with_a_problem(tmp_path, line, monkeypatch):
    live = live_vehicle(build_reference("VanDerPol", 3, tmp_path), tmp_path, line)
    live.release_time = 0  # as if it had been armed

    def refuse(self, h):
        raise InputError("FMU", "it refused a step of 0.01 s")

    monkeypatch.setattr(FmuInstance, "step", refuse)
    service = live.serve(duration=seconds(5))
    assert service.problems == ("it refused a step of 0.01 s",)
    assert service.t < seconds(1)


@pytest.mark.real_time
def test_real_time_flight_is_signed_and_matches_simulation(tmp_path):
    """From its release on, the log equals the simulation step by step; VanDerPol has no inputs."""
    file = build_reference("VanDerPol", 3, tmp_path)
    place, settings = f"udp://127.0.0.1:{free_port()}", ("--set", "trust_code=yes", "--no-real-time", "--duration", "2")
    there, here = fly_pair(tmp_path, str(file), place, place, *settings)
    assert (tmp_path / "config" / "keys" / "VanDerPol3.key").is_file()
    assert (there.status, here.status) == (0, 0), (there.said, here.said)
    log, simulated = (
        read_mcap(tmp_path / "there" / "vehicle.mcap"),
        simulate(build(str(file), TRUST), log_period=ms(10)),
    )
    moving = np.flatnonzero(log["truth.x1"] != 0.0)  # from 10 ms after it was let go on, by its own steps
    rows = np.searchsorted(log.ticks, log.ticks[moving[0]] + ms(10) * np.arange(150))
    for name in ("x0", "x1"):
        assert np.array_equal(log[f"truth.{name}"][rows], simulated[f"truth.{name}"][1:151])


def test_untrusted_fmu_code_is_not_run(tmp_path, monkeypatch):
    monkeypatch.setattr(fmpy, "instantiate_fmu", lambda *_, **__: pytest.fail("it was loaded"))
    file = build_reference("Dahlquist", 3, tmp_path)
    assert read_interface(str(file)).outputs[0].name == "x"  # its description is data
    with pytest.raises(InputError, match='"trust_code": "yes"'):
        build(str(file))
    with pytest.raises(InputError, match='"trust_code": "yes"'):
        simulate(replace(build(str(file), TRUST), world=replace(build(str(file), TRUST).world, vehicle=load(file))))


def test_compiling_an_fmu_scenario_is_rejected(tmp_path):
    scenario = build(str(build_reference("Dahlquist", 3, tmp_path)), TRUST)
    with pytest.raises(InputError, match="use trimtab run, vehicle or fly, which step an FMU"):
        compile_scenario(scenario)


@pytest.mark.thorough("trim {}", "design {} --lqr", "firmware {} --out board")
@pytest.mark.parametrize("line", ["trim {}", "linearise {}", "design {} --lqr", "firmware {} --out board"])
def test_commands_needing_equations_fail_without_side_effects(line, tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CONFIG", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    file = build_reference("BouncingBall", 3, tmp_path)
    said = CliRunner().invoke(main, [*line.format(file).split(), "--set", "trust_code=yes"])
    assert said.exit_code == 2
    assert "called step by step" in said.stderr
    assert not (tmp_path / "config").exists()
    assert not (tmp_path / "board").exists()


def test_rejects_invalid_fmu_files_and_names(tmp_path):
    (tmp_path / "x.fmu").write_text("nothing")
    with pytest.raises(InputError, match="can't be read as an FMU"):
        build(str(tmp_path / "x.fmu"), TRUST)
    with pytest.raises(InputError, match="file not found"):
        build(str(tmp_path / "y.fmu"), TRUST)
    file = build_reference("Dahlquist", 3, tmp_path)
    with pytest.raises(InputError, match="no parameter"):
        load(file, settings={"mass": 1.0})
    with pytest.raises(InputError, match="no output"):
        load(file, motion_of={"p_WB[0]": "north"})
    with pytest.raises(InputError, match="has no component"):
        load(file, motion_of={"north": "x"})
    with pytest.raises(InputError, match="does not start"):
        simulate(build(str(build_without_binary(file, tmp_path)), TRUST))


def build_without_binary(file, folder):
    """The same FMU, its binary left out."""
    bare = folder / "bare.fmu"
    with zipfile.ZipFile(file) as whole, zipfile.ZipFile(bare, "w") as archive:
        archive.writestr("modelDescription.xml", whole.read("modelDescription.xml"))
    return bare
