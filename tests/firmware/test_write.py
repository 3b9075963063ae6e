"""What is written for a board, and what is refused."""

import re
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner
from firmware.host import KEY

from trimtab.actuators.allocation import DirectActuation
from trimtab.cli import main
from trimtab.compiler.block import BlockDefinition, block_text
from trimtab.core.errors import InputError
from trimtab.core.record import quantity, record, replace
from trimtab.core.signals import Command, Frame, Sample
from trimtab.export.boards import missing_tools
from trimtab.export.firmware_folder import refuse_workspaces, replace_hardware, samples_source, write_firmware
from trimtab.scenarios import catalogue
from trimtab.wire.dialect import derive_dialect


def forward():
    return catalogue.load_scenario("hovercraft/forward", {})[0]


def test_another_board_is_refused(tmp_path):
    with pytest.raises(InputError, match="cortex-m7"):
        write_firmware(forward(), tmp_path / "out", KEY, board="z80")
    assert not (tmp_path / "out").exists()


def test_a_vehicle_without_a_fan_is_refused(tmp_path):
    scenario = forward()
    other = replace(scenario, world=replace(scenario.world, actuators=DirectActuation()))
    with pytest.raises(InputError, match="FanDrive"):
        write_firmware(other, tmp_path / "out", KEY)


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--out"):
        write_firmware(forward(), tmp_path / "file", KEY)


def test_a_block_that_needs_a_workspace_is_refused():
    def step(p, s, u):
        return s, jnp.cumsum(jnp.sin(jnp.arange(30_000.0) * u))[::-1].sum()

    wide = block_text(BlockDefinition("wide", "Wide.", step, lambda p: np.zeros(1), (), 0.0))
    with pytest.raises(InputError, match="'wide' needs a workspace of 480000 bytes"):
        refuse_workspaces([wide])


def test_the_links_of_the_scenario_are_left_out_and_servo_frames_are_the_firmwares():
    world = replace_hardware(forward()).world
    assert {type(world.uplink).__name__, type(world.downlink).__name__} == {"Wire"}
    assert world.actuators.frame == world.actuators.period == 10_000


def test_the_instants_are_those_of_the_world(written):
    text = (written.folder / "emulated" / "instants.h").read_text()
    assert re.search(r"PERIODS\[\] = {10000, 60000}", text)


@record
class Many:
    """More numbers than fit into one message. Source: this test."""

    field: object = quantity("T", "Measured.", shape=(40,))


def test_a_sample_in_several_messages_is_sent_with_every_number_once():
    value = Many(field=np.zeros(40))
    sample = Sample(value, np.int64(0), np.float64(0), np.bool_(False), np.bool_(False))
    frame, command = Frame(np.int64(0), {"array": sample}), Command(np.int64(0), np.bool_(False), value)
    dialect = derive_dialect(frame, command)
    text = samples_source(frame, dialect)
    places = re.findall(r"\.field\[(\d+)\] = \(double\)out->sensors\.array\.value\.field\[(\d+)\];", text)
    assert sorted(int(source) for _, source in places) == list(range(40))
    assert text.count("link_send") == len(dialect.groups["samples.array"]) == 2


def test_the_command_writes_a_folder_with_a_new_key(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CONFIG", str(tmp_path / "config"))
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "cache"))
    words = ["firmware", "hovercraft/forward", "--out", str(tmp_path / "out"), "--board", "cortex-m4"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "config" / "keys" / "hovercraft.key").stat().st_mode & 0o077 == 0
    assert "BOARD ?= cortex-m4" in (tmp_path / "out" / "Makefile").read_text()
    assert "typedef float world_real" in (tmp_path / "out" / "exported" / "world.h").read_text()
    assert "make -C" in done.stdout
    if missing_tools():
        return
    done = subprocess.run(["make", "-s"], cwd=tmp_path / "out", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
