"""The world alone: sampling, holding, links, actuators, and invalid configurations."""

from typing import Any

import numpy as np
import pytest
from loop.cart import SECOND, Drive, Place, Ruler, Speed, cart_world

from trimtab.core.errors import InputError
from trimtab.core.record import period, quantity, record, replace
from trimtab.core.rng import key
from trimtab.core.signals import Command
from trimtab.core.time import Instant, ms
from trimtab.links.wire import DelayChain, Wire
from trimtab.loop.structure import strengthen_types

ALL = frozenset({SECOND})


def command(t, v, valid=True):
    """Return a command issued at t."""
    return Command(t=np.int64(t), valid=np.bool_(valid), value=Speed(np.float64(v)))


def started(world, x=0.0):
    """Return the world's initial state, with its uplink."""
    return strengthen_types(world.connect(key(0), world.init(key(0), Place(np.float64(x))), command(0, 0.0)))


def test_initial_state_has_no_valid_samples_or_commands():
    s = started(cart_world(), 2.0)
    assert not bool(s.sampled["ruler"].valid)
    assert not bool(s.received["ruler"].valid)
    assert not bool(s.commanded.valid)
    assert float(s.u.v) == 0.0
    assert float(s.x.x) == 2.0


def test_frame_contains_the_newest_sample_of_each_sensor():
    world = cart_world(sensors={"ruler": Ruler(), "slow": Ruler(period=2 * SECOND)})
    s, frame = world.sense(Instant(np.int64(0), ALL), started(world, 2.0))
    s = replace(s, x=Place(np.float64(5.0)))
    s, frame = world.sense(Instant(np.int64(SECOND), ALL), s)
    assert int(frame.t) == SECOND
    assert list(frame.samples) == ["ruler", "slow"]
    new, held = frame.samples["ruler"], frame.samples["slow"]
    assert (float(new.value.x), int(new.t), float(new.age), bool(new.fresh)) == (5.0, SECOND, 0.0, True)
    assert (float(held.value.x), int(held.t), float(held.age), bool(held.fresh)) == (2.0, 0, 1.0, False)
    assert bool(held.valid)


def test_downlink_holds_its_sample_until_due():
    world = cart_world(downlink=Wire(period=2 * SECOND))
    s, _ = world.sense(Instant(np.int64(0)), started(world, 2.0))
    s, frame = world.sense(Instant(np.int64(SECOND)), replace(s, x=Place(np.float64(5.0))))
    assert float(s.sampled["ruler"].value.x) == 5.0
    received = frame.samples["ruler"]
    assert (float(received.value.x), float(received.age), bool(received.fresh)) == (2.0, 1.0, False)
    _, frame = world.sense(Instant(np.int64(2 * SECOND)), replace(s, x=Place(np.float64(6.0))))
    assert (float(frame.samples["ruler"].value.x), bool(frame.samples["ruler"].fresh)) == (6.0, True)


def test_command_acts_when_the_uplink_delivers_it():
    world = cart_world(uplink=DelayChain(SECOND, 1))
    s = world.act(Instant(np.int64(0), ALL), started(world), command(0, 3.0), True)
    assert float(s.u.v) == 0.0
    s = world.act(Instant(np.int64(SECOND), ALL), s, command(SECOND, 4.0), True)
    assert float(s.u.v) == 3.0
    assert (int(s.commanded.t), float(s.commanded.age)) == (0, 1.0)


def test_actuators_hold_their_output_until_due():
    world = cart_world(actuators=Drive(period=2 * SECOND))
    s = world.act(Instant(np.int64(0)), started(world), command(0, 3.0), True)
    s = world.act(Instant(np.int64(SECOND)), s, command(SECOND, 4.0), True)
    assert (float(s.commanded.value.v), float(s.u.v), float(s.actuated.u.v)) == (4.0, 3.0, 3.0)
    s = world.act(Instant(np.int64(2 * SECOND)), s, command(SECOND, 4.0), False)
    assert float(s.u.v) == 4.0


def test_invalid_command_leaves_the_actuators_neutral():
    world = cart_world()
    s = world.act(Instant(np.int64(0), ALL), started(world), command(0, 3.0, valid=False), True)
    assert float(s.u.v) == 0.0


def test_truth_advances_with_held_actuator_output():
    world = cart_world()
    s = world.act(Instant(np.int64(0), ALL), started(world, 1.0), command(0, 3.0), True)
    assert float(world.advance(np.int64(0), s, np.int64(ms(500))).x.x) == pytest.approx(2.5, abs=1e-12)
    assert float(world.advance(np.int64(0), s, np.int64(0)).x.x) == 1.0


def test_recomputed_outputs_are_dropped_from_the_state():
    world = cart_world(sensors={"ruler": Ruler(), "slow": Ruler(period=2 * SECOND)})
    s = world.drop_derived_outputs(started(world), ALL)
    assert s.sampled["ruler"] == ()
    assert s.sampled["slow"] != ()
    assert s.received == {"ruler": (), "slow": ()}
    assert (s.commanded, s.actuated) == ((), ())
    assert float(s.u.v) == 0.0, "integrated, so kept"


@record
class Thermometer:
    """Reads a field that no motion has. Source: this test."""

    period: int = period("Time between samples.", default=SECOND)

    def init(self, key: Any) -> tuple[()]:
        return ()

    def step(self, t: Any, state: Any, motion: Any) -> Any:
        return state, motion.temperature


@record
class Torque:
    """A command that the drive does not accept. Source: this test."""

    torque: Any = quantity("N m", "About the axle.")


def test_mismatched_parts_raise_an_error_naming_both():
    with pytest.raises(InputError, match=r"world\.sensors\.warmth: does not fit world\.vehicle.*temperature"):
        cart_world(sensors={"warmth": Thermometer()}).init(key(0), Place(0.0))
    world = cart_world()
    with pytest.raises(InputError, match=r"world\.actuators: does not fit world\.uplink"):
        world.connect(key(0), world.init(key(0), Place(0.0)), Command(np.int64(0), np.bool_(True), Torque(0.0)))
    with pytest.raises(InputError, match=r"world\.vehicle\.motion: does not fit the vehicle's state"):
        world.init(key(0), Speed(0.0))


def test_rejects_duplicate_sensor_names():
    assert list(cart_world(sensors=[("a", Ruler()), ("b", Ruler())]).sensors) == ["a", "b"]
    with pytest.raises(InputError, match="two sensors are named 'a': Ruler and Thermometer"):
        cart_world(sensors=[("a", Ruler()), ("a", Thermometer())])


def test_periods_include_sensors_links_and_actuators():
    world = cart_world(sensors={"ruler": Ruler(period=ms(7))}, downlink=Wire(period=ms(3)), uplink=Wire(period=ms(2)))
    assert sorted(world.periods()) == [ms(2), ms(3), ms(7), SECOND]
