"""A pilot's stick: scripts, samples, the law that reads it, and errors where it is missing."""

import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.loop.fault_text import inject_faults
from trimtab.loop.stick_script import StickScript, add_stick_sensor, empty_sticks, stick_script
from trimtab.run.blocks import carried_structures, message_structures
from trimtab.run.replay import replay
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

SCRIPT = stick_script((ms(40), 0.5, -0.25, "assisted"), (ms(100), -1.0, 1.0, "manual"))


def load(name="hovercraft/pilot", **settings):
    return catalogue.load_scenario(name, settings)[0]


def with_stick(scenario, script):
    return replace(scenario, world=replace(scenario.world, sensors={**scenario.world.sensors, "stick": script}))


@pytest.mark.parametrize(
    ("t", "held"),
    [(0, None), (39, None), (40, (0.5, -0.25, 2)), (99, (0.5, -0.25, 2)), (100, (-1.0, 1.0, 0)), (900, (-1.0, 1.0, 0))],
)
def test_stick_holds_the_last_script_entry(t, held):
    """Each step gives a new sample with its own time; before the first entry the sample is invalid."""
    _, sample = SCRIPT.step(np.int64(ms(t)), (), None)
    assert (int(sample.t), float(sample.age)) == (ms(t), 0.0)
    assert (bool(sample.valid), bool(sample.fresh)) == (held is not None, held is not None)
    if held is not None:
        assert (float(sample.value.forward), float(sample.value.turn), int(sample.value.mode)) == held


def test_empty_script_is_never_valid():
    _, sample = StickScript().step(np.int64(seconds(5)), StickScript().init(None), None)
    assert not bool(sample.valid)
    assert not bool(sample.fresh)
    assert jax.tree.structure(sample.value) == jax.tree.structure(StickScript().measure(None))


def test_rejects_invalid_stick_scripts():
    with pytest.raises(InputError, match="unknown mode 'auto'"):
        stick_script((0, 0.0, 0.0, "auto"))
    with pytest.raises(InputError, match="rising order"):
        stick_script((ms(20), 0.0, 0.0, "manual"), (ms(20), 0.0, 0.0, "manual")).check()
    with pytest.raises(InputError, match="numbers of times, forward, turn and mode: 1, 2, 2, 2"):
        replace(SCRIPT, times=np.array([0], np.int64)).check()
    with pytest.raises(InputError, match=r"forward"):
        with_stick(load(), stick_script((0, 1.5, 0.0, "manual"))).check()
    SCRIPT.check()
    StickScript().check()


def test_adds_a_stick_sensor_where_the_law_needs_one():
    forward, scripted = load("hovercraft/forward"), load()
    assert add_stick_sensor(forward) is forward
    assert add_stick_sensor(scripted) is scripted
    sensors = {n: s for n, s in scripted.world.sensors.items() if n != "stick"}
    bare = replace(scripted, world=replace(scripted.world, sensors=sensors))
    added = add_stick_sensor(bare).world.sensors
    assert [*added] == [*sensors, "stick"]
    assert np.size(added["stick"].times) == 0


def test_rejects_an_autopilot_without_its_stick():
    scenario = load()
    law = replace(scenario.autopilot.law, stick="joystick")
    with pytest.raises(InputError) as refused:
        simulate(replace(scenario, autopilot=replace(scenario.autopilot, law=law)), duration=ms(10))
    said = str(refused.value)
    assert "autopilot.law.stick" in said
    assert "Piloted reads the pilot's stick 'joystick', but the world sends only (navigation, stick)" in said
    assert 'add sensors={"joystick": StickScript(…)} to the world' in said


def test_stick_without_script_is_not_sent_over_the_link():
    """A stick without a script is not sent over the link; a scripted one is. The autopilot's frame contains both."""
    console, script = load(stick="console"), load()
    assert (empty_sticks(console), empty_sticks(script)) == (("stick",), ())
    faulty = inject_faults(console, ["sensor:stick off @ 1 s"])
    assert empty_sticks(faulty) == ("stick",)
    assert "stick" in message_structures(console)[0].samples
    assert [*carried_structures(console)[0].samples] == ["navigation"]
    assert [*carried_structures(script)[0].samples] == ["navigation", "stick"]
    sensors = {"navigation": console.world.sensors["navigation"]}
    bare = replace(console, world=replace(console.world, sensors=sensors))
    assert [*carried_structures(bare)[0].samples] == ["navigation"]


@pytest.mark.thorough
def test_law_follows_the_delayed_stick_and_replays_exactly():
    """Over the radio the stick is 36 ms old or more; the logged estimate does not contain it."""
    scenario = with_stick(load(), stick_script((0, 0.2, 0.3, "manual"), (ms(400), 0.6, 0.5, "damped")))
    log = simulate(scenario, duration=seconds(1))
    changed = np.flatnonzero(np.diff(log["law.mode"][100:]) != 0)[0] + 101
    assert log.t[changed] == pytest.approx(0.440, abs=0.007)
    assert log["downlink.stick.age"][200:].min() >= 0.036
    assert log["downlink.stick.age"][200:].max() < 0.064
    assert not log["law.stick_lost"][100:].any()
    assert not [p for p in log.paths if p.startswith("estimate.stick")]
    assert replay(log, scenario).exact


def test_the_ideal_twin_keeps_the_stick():
    twin = load().ideal()
    assert [*twin.world.sensors] == ["truth", "stick"]
    assert [*load("hovercraft/forward").ideal().world.sensors] == ["truth"]
