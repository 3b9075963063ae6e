"""A servo's frame against numpy's sample and hold, in a bank, in lanes, and on a board."""

import jax
import numpy as np
import pytest

import trimtab
from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.servo_frame import ServoFrame
from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.signals import PlanarForce, Sample
from trimtab.core.time import ms
from trimtab.flight.boards.firmware_folder import replace_hardware
from trimtab.flight.boards.pulse_outputs import frame_of
from trimtab.scenarios.build import build

DT = 1e-3
COMMAND = np.random.default_rng(0).normal(0, 1, 200)


def fly(stage, command=COMMAND, rest=0.25):
    return np.asarray(
        jax.jit(lambda u: jax.lax.scan(lambda s, v: stage.step(s, v, DT), stage.init(rest), u)[1].value)(command)
    )


def sample_and_hold(command, frame, phase, rest):
    """What numpy makes of it, frame and phase in periods."""
    k = np.arange(len(command))
    last = (k - phase) // frame * frame + phase
    return np.where(last >= 0, command[np.maximum(last, 0)], rest)


@pytest.mark.parametrize(("frame", "phase"), [(20, 0), (20, 7), (20, 19), (1, 0), (3, 2)])
def test_frame_is_sample_and_hold_bit_for_bit(frame, phase):
    got = fly(ServoFrame(frame=ms(frame), phase=ms(phase)))
    np.testing.assert_array_equal(got, sample_and_hold(COMMAND, frame, phase, 0.25))


def test_fractional_millisecond_frame_is_sample_and_hold():
    stage = ServoFrame(frame=25_000, phase=5_000)
    state, out = stage.init(0.0), []
    for value in COMMAND[:50]:
        state, said = stage.step(state, value, 5e-4)
        out.append(float(said.value))
    np.testing.assert_array_equal(out, sample_and_hold(COMMAND[:50], 5, 1, 0.0))


def test_disabled_frame_passes_the_command():
    np.testing.assert_array_equal(fly(without(ServoFrame(phase=ms(3)), "servo-frame")), COMMAND)


def test_compiled_c_and_lanes_match_sample_and_hold():
    stage = ServoFrame(frame=ms(4), phase=ms(1))

    def hold(u):
        return jax.lax.scan(lambda s, v: stage.step(s, v, DT), stage.init(0.25), u)[1].value

    many = COMMAND.reshape(8, 25)
    compiled = trimtab.compile(hold, many[0])
    wanted = [sample_and_hold(u, 4, 1, 0.25) for u in many]
    np.testing.assert_array_equal(compiled(many[0]), wanted[0])
    np.testing.assert_array_equal(compiled.lanes(many), wanted)


def test_each_field_of_a_bank_has_its_own_frame():
    bank = ActuatorBank(
        PlanarForce(0.0, 0.0), {"FX": ServoFrame(frame=ms(5)), "FY": ServoFrame(frame=ms(5), phase=ms(2))}
    )
    bank.check()
    state, got = bank.init(key(0, 0)), []
    for k in range(20):
        value = PlanarForce(FX=COMMAND[k], FY=COMMAND[k])
        said = Sample(value=value, t=np.int64(0), age=np.float64(0), fresh=np.bool_(True), valid=np.bool_(True))
        state, out = bank.step(ms(k), state, said)
        got.append((float(out.u.FX), float(out.u.FY)))
    held = [sample_and_hold(COMMAND[:20], 5, phase, 0.0) for phase in (0, 2)]
    np.testing.assert_array_equal(np.transpose(got), held)


@pytest.mark.parametrize(
    ("stage", "words"),
    [
        (ServoFrame(frame=25_000), r"2\.5 ms must be a multiple of the actuators' period of 1 ms"),
        (ServoFrame(phase=5_000), "0.5 ms must be a multiple"),
        (ServoFrame(phase=ms(20)), "must be shorter than the frame"),
    ],
)
def test_rejects_frame_not_multiple_of_period(stage, words):
    with pytest.raises(InputError, match=words):
        ActuatorBank(PlanarForce(0.0, 0.0), {"FX": stage}).check()


def test_board_uses_servo_frame_and_world_does_not_repeat_it():
    scenario = build("examples/my_boat.py:scenario")
    bank = scenario.world.actuators
    bank = replace(bank, stages=bank.stages | {"rudder": (ServoFrame(frame=ms(20)), *bank.stages["rudder"])})
    framed = replace(scenario, world=replace(scenario.world, actuators=bank))
    assert frame_of(scenario) == bank.period == ms(10)
    assert frame_of(framed) == ms(20)
    both = {name: (ServoFrame(frame=ms(5)), *stages) for name, stages in scenario.world.actuators.stages.items()}
    both["rudder"] = bank.stages["rudder"]
    assert len(both) > 1
    mixed = replace(scenario, world=replace(scenario.world, actuators=replace(bank, stages=both)))
    assert frame_of(mixed) == ms(20)  # the rudder's analogue servo overheats in a shorter frame
    assert replace_hardware(framed).world.actuators.stages["rudder"][0].frame == 0
