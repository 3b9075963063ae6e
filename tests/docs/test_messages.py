"""The page of messages, generated from the sources, contains the program's error messages."""

import importlib.util
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab import Campaign, InputError, build, compile, read_log, seconds, simulate
from trimtab.cli import main
from trimtab.flight.transports.open_link import parse_uri

DOCS = Path(__file__).parents[2] / "docs"
spec = importlib.util.spec_from_file_location("messages", DOCS / "messages.py")
messages = importlib.util.module_from_spec(spec)
spec.loader.exec_module(messages)

WRONG = {
    "a mass in a unit of length": lambda: build("hovercraft/spin", {"world.vehicle.mass": "3 m"}),
    "unknown setting": lambda: build("hovercraft/spin", {"world.vehicle.mas": "3"}),
    "a mass below zero": lambda: build("hovercraft/spin", {"world.vehicle.mass": "-1"}),
    "unknown scenario": lambda: build("hovercraft/spinn"),
    "a file without the function": lambda: build(f"{__file__}:scenario"),
    "time as a word": lambda: seconds("soon"),
    "file that is not a log": lambda: read_log(__file__),
    "a link without a scheme": lambda: parse_uri("127.0.0.1:14550"),
    "a link without a port": lambda: parse_uri("udp://127.0.0.1").host_and_port(),
    "a campaign without runs": lambda: Campaign("hovercraft/spin", runs=0),
    "unknown metric": lambda: Campaign("hovercraft/spin", runs=2, metrics=["yaw_rate"]),
    "a duration below zero": lambda: simulate("hovercraft/spin", duration=-1.0),
    "an argument of another shape": lambda: compile(np.sin, np.zeros(3))(np.zeros(4)),
}
TYPED = {
    "a path without a value": "run hovercraft/spin --set world.vehicle.mass",
    "unknown folder of scenarios": "list submarine/dive",
    "a name with a dash": "new law my-law",
}


@cache
def said():
    return messages.read_messages()


def refusal(do):
    with pytest.raises(InputError) as refused:
        do()
    return f"{refused.value.part}: {refused.value.problem}"


def matching(text):
    """Those that, their holes filled, are this text: the one with the most words of its own."""
    text = " ".join(text.split())
    found = []
    for message in said():
        pattern = r".*".join(re.escape(piece) for piece in message.text.split("…"))
        if re.fullmatch(rf"(?:.*?: )??{pattern}\.?", text):
            found.append(message)
    return max(found, key=lambda m: len(re.findall(r"\w+", m.text)), default=None)


@pytest.mark.thorough
@pytest.mark.parametrize("what", WRONG)
def test_python_errors_are_on_the_messages_page(what):
    assert matching(refusal(WRONG[what]))


@pytest.mark.thorough
@pytest.mark.parametrize("what", TYPED)
def test_command_line_errors_are_on_the_messages_page(what):
    answer = CliRunner().invoke(main, TYPED[what].split())
    assert answer.exit_code == 2
    assert matching(answer.stderr.splitlines()[0].removeprefix("Error: ")), answer.stderr


@pytest.mark.thorough
def test_foreign_message_is_not_on_the_messages_page():
    assert matching("world.vehicle.mass: the moon is in its way") is None


def test_message_text_is_resolved_through_names_branches_and_functions(tmp_path, monkeypatch):
    monkeypatch.setattr(messages, "PACKAGE", tmp_path)
    (tmp_path / "hull.py").write_text(
        "class InputError:\n"
        "    def __init__(self, part, problem, *, fix=''): pass\n"
        "FIX = 'write {0} or more'\n"
        "def why(n):\n"
        "    if n: return f'it has {n} holes'\n"
        "    return 'it has no hull'\n"
        "def refuse(part, problem): raise InputError(part, problem, fix=FIX)\n"
        "def check(boat):\n"
        "    text = 'it sank ' + ('at once' if boat else 'slowly')\n"
        "    refuse('boat', text)\n"
        "    raise InputError(f'boat {boat}', why(2))\n"
    )
    assert [(m.module, m.text) for m in messages.read_messages()] == [
        ("hull", "boat: it sank at once"),
        ("hull", "boat: it sank slowly"),
        ("hull", "boat …: it has … holes"),
        ("hull", "boat …: it has no hull"),
    ]


def test_nearly_every_input_error_is_on_the_messages_page():
    """A call without own words, such as an error passed on, is listed where its words are written."""
    calls = sum(len(re.findall(r"\bInputError\(", path.read_text("utf-8"))) for path in messages.PACKAGE.rglob("*.py"))
    assert len(said()) > 0.95 * calls
