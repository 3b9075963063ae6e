"""The order of the loop at one instant, and the effects of sampling, holding and delays: docs page, Time."""

import jax
import numpy as np
import pytest
from loop.cart import SECOND, Place, Ruler, cart_autopilot, cart_world

from trimtab.core.rng import key
from trimtab.core.time import Instant, ms, timetable
from trimtab.links.wire import DelayChain
from trimtab.loop.walk import instant, logged_signals, pack_row, signals, start, walk


def fly(world, autopilot, n=5, paths=(), every=1):
    """Return the signals of n instants by path, each an array. every: instants per row of the log."""
    table = timetable([*world.periods(), autopilot.period], n * SECOND, world.max_step)
    count = len(table.t)
    rows = -(-count // every)
    number = np.where(np.arange(count) % every == 0, np.arange(count) // every, rows)
    instants = table.t, table.h, number
    result = jax.jit(lambda x, key: walk(world, autopilot, x, key, instants, rows, table.always, paths))(
        Place(0.0), key(0)
    )
    out, k = {}, 0
    first = jax.eval_shape(lambda x, key: signals(*start(world, autopilot, x, key)), Place(0.0), key(0))
    for path, value, _ in logged_signals(first, paths):
        out[path] = np.asarray(result.rows[:, k : k + np.size(value)]).squeeze(1)
        k += np.size(value)
    assert k == result.rows.shape[1]
    return out, result


def test_measurement_acts_at_its_own_instant():
    """v = 1 + x, held for a second, so x becomes 2 x + 1. Any hidden delay would change the numbers."""
    log, result = fly(cart_world(), cart_autopilot())
    np.testing.assert_allclose(log["truth.x"], [0, 1, 3, 7, 15], atol=1e-12)
    np.testing.assert_allclose(log["actuators.u.v"], [1, 2, 4, 8, 16], atol=1e-12)
    for path in ("sensors.ruler.value.x", "downlink.ruler.value.x", "estimate.state.x"):
        np.testing.assert_array_equal(log[path], log["truth.x"], err_msg=path)
    for path in ("law.demand.v", "command.value.v", "uplink.value.v"):
        np.testing.assert_array_equal(log[path], log["actuators.u.v"], err_msg=path)
    assert float(result.x.x) == pytest.approx(31, abs=1e-12), "the truth at the end is after the last instant"
    assert int(result.sensors["ruler"]) == 5


def test_sensors_measure_the_input_applied_until_now():
    log, _ = fly(cart_world(), cart_autopilot())
    np.testing.assert_allclose(log["sensors.ruler.value.v"], [0, 1, 2, 4, 8], atol=1e-12)


def test_downlink_delay_appears_as_estimate_age():
    log, _ = fly(cart_world(downlink=DelayChain(SECOND, 1)), cart_autopilot())
    np.testing.assert_array_equal(log["estimate.valid"], [0, 1, 1, 1, 1])
    np.testing.assert_allclose(log["truth.x"], [0, 0, 1, 2, 4], atol=1e-12)
    np.testing.assert_allclose(log["actuators.u.v"], [0, 1, 1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(log["estimate.age"][1:], 1.0)
    np.testing.assert_array_equal(log["downlink.ruler.t"][1:], np.arange(4) * SECOND)


def test_uplink_delay_holds_actuators_neutral_and_keeps_command_time():
    log, _ = fly(cart_world(uplink=DelayChain(SECOND, 2)), cart_autopilot())
    np.testing.assert_array_equal(log["command.valid"], 1)
    np.testing.assert_array_equal(log["uplink.valid"], [0, 0, 1, 1, 1])
    np.testing.assert_allclose(log["truth.x"], [0, 0, 0, 1, 2], atol=1e-12)
    np.testing.assert_array_equal(log["uplink.t"][2:], np.arange(3) * SECOND)
    np.testing.assert_allclose(log["uplink.age"][2:], 2.0)


def test_a_slow_autopilot_holds_its_command():
    log, _ = fly(cart_world(), cart_autopilot(period=2 * SECOND))
    np.testing.assert_allclose(log["actuators.u.v"], [1, 1, 3, 3, 9], atol=1e-12)
    np.testing.assert_allclose(log["truth.x"], [0, 1, 2, 5, 8], atol=1e-12)
    np.testing.assert_array_equal(log["command.t"], np.array([0, 0, 2, 2, 4]) * SECOND)
    np.testing.assert_allclose(log["uplink.age"], [0, 1, 0, 1, 0])
    np.testing.assert_array_equal(log["uplink.fresh"], [1, 0, 1, 0, 1])
    np.testing.assert_array_equal(log["estimate.t"], np.arange(5) * SECOND)
    np.testing.assert_array_equal(log["estimate.fresh"], [1, 0, 1, 0, 1])


def test_a_slow_sensor_holds_its_sample():
    log, _ = fly(cart_world(sensors={"ruler": Ruler(period=2 * SECOND)}), cart_autopilot())
    np.testing.assert_array_equal(log["downlink.ruler.t"], np.array([0, 0, 2, 2, 4]) * SECOND)
    np.testing.assert_allclose(log["estimate.age"], [0, 1, 0, 1, 0])
    np.testing.assert_array_equal(log["estimate.fresh"], [1, 0, 1, 0, 1])
    np.testing.assert_allclose(log["truth.x"], [0, 1, 2, 5, 8], atol=1e-12)


def test_extra_integration_instants_leave_the_run_unchanged():
    """With integration steps of 250 ms: the same run, four rows per second; held samples are not fresh."""
    fine, _ = fly(cart_world(max_step=ms(250)), cart_autopilot())
    np.testing.assert_allclose(fine["truth.x"], np.interp(np.arange(20) / 4, range(6), [0, 1, 3, 7, 15, 31]), atol=1e-9)
    np.testing.assert_array_equal(fine["sensors.ruler.fresh"], np.arange(20) % 4 == 0)
    np.testing.assert_array_equal(fine["command.t"], np.repeat(np.arange(5), 4) * SECOND)


def test_log_rows_are_the_requested_instants():
    whole, _ = fly(cart_world(), cart_autopilot())
    some, _ = fly(cart_world(), cart_autopilot(), every=2)
    assert whole.keys() == some.keys()
    for path, values in some.items():
        np.testing.assert_array_equal(values, whole[path][::2], err_msg=path)


def test_log_columns_are_the_requested_paths():
    log, _ = fly(cart_world(), cart_autopilot(), paths=("truth", "command.value"))
    assert list(log) == ["truth.x", "command.value.v"]
    np.testing.assert_allclose(log["command.value.v"], [1, 2, 4, 8, 16], atol=1e-12)


def test_single_instant_computes_frame_command_and_truth():
    """Frame in, command out, and the truth advances last."""
    world, autopilot = cart_world(), cart_autopilot()
    s, a = start(world, autopilot, Place(3.0), key(0))
    assert not bool(s.received["ruler"].valid)
    assert not bool(a.command.valid)
    s, a, seen = instant(world, autopilot, Instant(np.int64(0), frozenset({SECOND})), np.int64(SECOND), s, a)
    assert (float(seen.truth.x), float(seen.command.value.v), float(seen.actuators.u.v)) == (3.0, 4.0, 4.0)
    assert bool(seen.command.valid)
    assert float(s.x.x) == pytest.approx(7.0, abs=1e-12)
    row = np.asarray(pack_row(signals(s, a), ("truth", "actuators")))
    np.testing.assert_allclose(row, [7.0, 4.0], atol=1e-12)
