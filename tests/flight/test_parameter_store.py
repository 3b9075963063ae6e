"""Parameters are stored only on a station's request."""

import json

import numpy as np
import pytest
from flight.station.clients import Master, common
from flight.station.test_parameters import Inner, Outer

from trimtab.core.errors import InputError
from trimtab.flight.parameter_store import ParameterStore, read_parameters
from trimtab.flight.scenario_identity import setting_path
from trimtab.flight.station.parameters import Parameters
from trimtab.loop.settings import with_settings

STORAGE, WRITE, RESET = 245, 1, 2
ACCEPTED, NOT_NOW, UNSUPPORTED, FAILED = 0, 1, 3, 4


@pytest.fixture
def dialect():
    from flight.mavlink.conftest import made

    return made()


def tree(file):
    """The vehicle at its start: default values, then stored parameters."""
    whole = {"vehicle": Outer(Inner(2.6, np.array([0.1, 0.2]), 3, 1, True), 0.2)}
    return with_settings(whole, read_parameters(file, "a"))


def start(dialect, file):
    store = ParameterStore(file, "a")
    return Master(dialect, parameters=Parameters(tree(file)), store=store.write)


def command(master, number, first):
    master.mav.command_long_send(1, 1, number, 0, first, 0, 0, 0, 0, 0, 0)
    return master.recv_match("COMMAND_ACK").result


def change(master, name, value):
    master.mav.param_set_send(1, 1, name, value, common.MAV_PARAM_TYPE_REAL32)
    return master.recv_match("PARAM_VALUE").param_value


def test_only_stored_parameters_survive_a_restart(dialect, tmp_path):
    file = tmp_path / "kept.json"
    first = start(dialect, file)
    change(first, b"VI_MASS", 3.5)
    change(first, b"VI_GAINS_1", 0.75)
    assert not file.exists()
    assert command(first, STORAGE, WRITE) == ACCEPTED
    change(first, b"V_DRAG", 9.0)  # not stored
    again = tree(file)["vehicle"]
    assert (again.inner.mass, again.drag) == (3.5, 0.2)
    assert again.inner.gains.tolist() == [0.1, 0.75]
    second = start(dialect, file)
    change(second, b"V_DRAG", 0.5)
    assert command(second, STORAGE, WRITE) == ACCEPTED
    assert (tree(file)["vehicle"].inner.mass, tree(file)["vehicle"].drag) == (3.5, 0.5)


def test_last_of_several_changed_values_is_stored(dialect, tmp_path):
    file = tmp_path / "kept.json"
    master = start(dialect, file)
    for value in (5.0, 4.0, 3.0):
        change(master, b"VI_COUNT", value)
        assert command(master, STORAGE, WRITE) == ACCEPTED
    assert tree(file)["vehicle"].inner.count == 3


def test_reset_restores_default_parameters(dialect, tmp_path):
    file = tmp_path / "kept.json"
    master = start(dialect, file)
    change(master, b"VI_MASS", 3.5)
    assert command(master, STORAGE, WRITE) == command(master, STORAGE, RESET) == ACCEPTED
    assert tree(file)["vehicle"].inner.mass == 2.6


def test_store_is_refused_while_armed_or_without_writable_file(dialect, tmp_path):
    file = tmp_path / "kept.json"
    master = start(dialect, file)
    change(master, b"VI_MASS", 3.5)
    master.fly(True)
    assert command(master, STORAGE, WRITE) == NOT_NOW
    assert not file.exists()
    master.fly(False)
    assert command(master, STORAGE, 3) == UNSUPPORTED
    assert command(start(dialect, None), STORAGE, WRITE) == FAILED
    assert command(start(dialect, tmp_path / "no" / "folder.json"), STORAGE, WRITE) == FAILED


def test_fault_parameters_are_not_stored(tmp_path):
    file = tmp_path / "kept.json"
    store = ParameterStore(file, "a", setting_path)
    assert store.write({"world.sensors.imu.fault.kind": [3.0], "world.sensors.imu.inner.bias": [0.1, 0.2, 0.3]}) == ""
    assert json.loads(file.read_text())["parameters"] == {"world.sensors.imu.bias": [0.1, 0.2, 0.3]}


@pytest.mark.parametrize("text", ["", "{", "[]", '{"scenario": "a"}', '{"scenario": "a", "parameters": 3}', '"x"'])
def test_rejects_damaged_parameter_file_by_name(tmp_path, text):
    file = tmp_path / "kept.json"
    file.write_text(text)
    with pytest.raises(InputError, match=r"kept\.json.* cannot be read"):
        read_parameters(file, "a")
    assert "cannot be read" in ParameterStore(file, "a").write({"b.c": [1.0]})
    assert file.read_text() == text


def test_rejects_parameter_file_of_another_scenario(tmp_path):
    file = tmp_path / "kept.json"
    ParameterStore(file, "b").write({"world.vehicle.mass": [3.0]})
    with pytest.raises(InputError, match="belong to the scenario 'b', not to 'a'"):
        read_parameters(file, "a")
