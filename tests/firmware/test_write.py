"""The files written for a board, and invalid arguments."""

import re
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner
from firmware.host import KEY

from trimtab.actuators.failsafe import CAUSES, MODES
from trimtab.cli import main
from trimtab.compiler.block import BlockDefinition, block_text
from trimtab.core.errors import InputError
from trimtab.core.record import quantity, record
from trimtab.core.signals import Command, Frame, Sample
from trimtab.flight.boards.firmware_folder import (
    firmware_blocks,
    refuse_workspaces,
    replace_hardware,
    samples_source,
    write_firmware,
)
from trimtab.flight.boards.microcontrollers import missing_tools
from trimtab.flight.mavlink.dialect import derive_dialect
from trimtab.run.blocks import message_structures
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build


def forward():
    return catalogue.load_scenario("hovercraft/forward", {})[0]


def test_rejects_unknown_board(tmp_path):
    with pytest.raises(InputError, match="cortex-m7"):
        write_firmware(forward(), tmp_path / "out", KEY, board="z80")
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_rejects_unwritable_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="out"):
        write_firmware(forward(), tmp_path / "file", KEY)


def test_rejects_block_that_needs_a_workspace():
    def step(p, s, u):
        return s, jnp.cumsum(jnp.sin(jnp.arange(30_000.0) * u))[::-1].sum()

    wide = block_text(BlockDefinition("wide", "Wide.", step, lambda p: np.zeros(1), (), 0.0))
    with pytest.raises(InputError, match="'wide' needs a workspace of 480000 bytes"):
        refuse_workspaces([wide])


def test_hardware_scenario_omits_links_and_uses_firmware_servo_frame():
    world = replace_hardware(forward()).world
    assert {type(world.uplink).__name__, type(world.downlink).__name__} == {"Wire"}
    assert world.actuators.frame == world.actuators.period == 10_000


@pytest.mark.thorough
def test_instants_are_those_of_the_simulated_world(written):
    text = (written.folder / "emulated" / "instants.h").read_text()
    assert re.search(r"PERIODS\[\] = {10000, 60000}", text)


@record
class Many:
    """More numbers than fit into one message. Source: this test."""

    field: object = quantity("T", "Measured.", shape=(40,))


def test_sample_split_over_messages_sends_each_element_once():
    value = Many(field=np.zeros(40))
    sample = Sample(value, np.int64(0), np.float64(0), np.bool_(False), np.bool_(False))
    frame, command = Frame(np.int64(0), {"array": sample}), Command(np.int64(0), np.bool_(False), value)
    dialect = derive_dialect(frame, command)
    text = samples_source(frame, dialect)
    places = re.findall(r"\.field\[(\d+)\] = \(double\)out->sensors\.array\.value\.field\[(\d+)\];", text)
    assert sorted(int(source) for _, source in places) == list(range(40))
    assert text.count("link_send") == len(dialect.groups["samples.array"]) == 2


def test_missing_mavlink_generator_creates_no_key(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CONFIG", str(tmp_path / "config"))
    monkeypatch.setitem(sys.modules, "pymavlink.generator.mavgen", None)
    monkeypatch.delattr("pymavlink.generator.mavgen", raising=False)
    said = CliRunner().invoke(main, ["firmware", "hovercraft/forward", "--out", str(tmp_path / "out")])
    assert said.exit_code == 2
    assert 'pip install "trimtab[wire]"' in said.stderr
    assert not (tmp_path / "config").exists()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", ["firmware swarm/formation --out out", "vehicle swarm/formation --listen udp://:0"])
def test_rejects_swarm_and_creates_no_key(tmp_path, monkeypatch, verb):
    monkeypatch.setenv("TRIMTAB_CONFIG", str(tmp_path / "config"))
    said = CliRunner().invoke(main, verb.split())
    assert said.exit_code == 2
    assert "is for one vehicle, but this is a swarm of 5 craft" in said.stderr
    assert "hovercraft/forward" in said.stderr
    assert "trimtab export FILE.py:function" in said.stderr
    assert not (tmp_path / "config").exists()


def test_rejects_lockstep_without_emulated_board(tmp_path):
    words = ["firmware", "hovercraft/forward", "--out", str(tmp_path / "out"), "--lockstep"]
    for more in ([], ["--emulate", "5760", "--board", "stm32f405"]):
        said = CliRunner().invoke(main, [*words, *more])
        assert said.exit_code == 2
        assert "--board cortex-m7 --emulate 5760 --lockstep" in said.stderr
        assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_command_writes_folder_and_creates_key(tmp_path, monkeypatch):
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
    image = (tmp_path / "out" / "key.bin").read_bytes()
    assert image[8:40] not in (tmp_path / "out" / "firmware.elf").read_bytes()


def test_port_functions_are_implemented_used_and_documented():
    """Every board implements each function of port.h, and the README gives their number."""
    firmware = Path(__file__).parents[2] / "firmware"
    text = re.sub(r"/\*.*?\*/", "", (firmware / "portable" / "port.h").read_text(), flags=re.DOTALL)
    functions = re.findall(r"(board_\w+)\(", text)
    assert f"what a board has to offer: {len(functions)} functions" in (firmware / "README.md").read_text()
    parts = (firmware / "emulated" / "hardware.c", firmware / "drives" / "fan" / "actuators.c")
    emulated = "".join(path.read_text() for path in parts)
    for board in ("mps2", "stm32f405"):
        sources = "".join(path.read_text() for path in (firmware / "boards" / board).glob("*.c")) + emulated
        assert [f for f in functions if not re.search(rf"^[a-z].*\b{f}\(.*\) {{", sources, re.MULTILINE)] == []
    callers = [*(firmware / "portable").glob("*.c"), firmware / "drives" / "fan" / "drive.c", firmware / "main.c"]
    called = "".join(path.read_text() for path in callers)
    assert [f for f in functions if f"{f}(" not in called] == []
    page = (firmware.parent / "docs" / "export" / "boards.md").read_text()
    assert "twelve" not in page
    assert all(hook in page for hook in ("hardware_begin", "hardware_work"))
    pattern = r"/\* ((?:(?!\*/).)*) \*/\n((?:[^\n]+\);\n)+)"  # as on the page, which prints them
    comments = re.findall(pattern, (firmware / "portable" / "port.h").read_text(), re.DOTALL)
    assert re.findall(r"(board_\w+)\(", "".join(f for _, f in comments)) == functions
    assert "four functions" not in (firmware.parent / "docs" / "how-to" / "first-flight.md").read_text()


def test_mode_and_cause_names_match_the_failsafe():
    text = (Path(__file__).parents[2] / "firmware" / "portable" / "station.c").read_text()
    for name, words in (("MODES", MODES), ("CAUSES", CAUSES)):
        (listed,) = re.findall(rf"const {name}\[\] = {{(.*?)}};", text, re.DOTALL)
        assert tuple(re.findall(r'"([^"]*)"', listed)) == words
        assert f"name({name}, out->{name[:-1].lower()}, {len(words)})" in text


def test_firmware_uses_regulator_and_motor_settings_of_scenario():
    """Gain of the regulator and inertia of the motor; defaults for a scenario without a regulated fan."""
    settings = {"world.actuators.fan.regulator.kp": "0.0123", "world.actuators.fan.motor.inertia": "4.56e-5"}
    for given, wanted in (({}, (0.08, 2.2e-5)), (settings, (0.0123, 4.56e-5))):
        scenario = build("hovercraft/forward", given)
        _, command = message_structures(replace_hardware(scenario))
        _, regulator, motor = firmware_blocks(scenario, command, "f64")
        texts = [
            re.search(rf"->{name} = (.*);", b.source) for b, name in ((regulator, "kp"), (motor, r"motor\.inertia"))
        ]
        assert [float(found[1]) for found in texts] == pytest.approx(wanted, rel=1e-15)
