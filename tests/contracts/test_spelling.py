"""Error texts: the library names Python arguments, and only the command line writes them as options."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import trimtab
from trimtab.commands.verbs import OPTIONS, spell_option
from trimtab.core.errors import InputError, argument, argument_name, spell_with
from trimtab.core.suggestions import unknown_setting

SOURCE = Path(trimtab.__file__).parent
SAID_AT_A_TERMINAL = ("prearm.py", "connection_problem.py", "preflight.py", "remote.py", "safety_settings.py")
SAID_AT_A_TERMINAL += ("station/parameters.py",)
SAID_AT_A_TERMINAL = tuple(f"flight/{name}" for name in SAID_AT_A_TERMINAL)
"""What `trimtab fly` and `trimtab vehicle` say to those who typed them; it is on the line, too."""
OF_COMPILERS = ("native/", "flight/boards/microcontrollers.py", "compiler/")
COMMAND = r"(trimtab|export|python|dask|docker|typed|_command|link-test|vehicle and fly with)\b"
OPTION = re.compile(r"(?<![\w,-])--[a-z{]")


def option_texts(text: str) -> Iterator[tuple[int, str]]:
    """Line and text of each string, no docstring, that has an option which stands in no whole command."""
    if not OPTION.search(text):
        return
    tree = ast.parse(text)
    docs = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
    inner = {id(v) for n in ast.walk(tree) if isinstance(n, ast.JoinedStr) for v in n.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            said = "".join(v.value if isinstance(v, ast.Constant) else ast.unparse(v) for v in node.values)  # pyright: ignore[reportCallIssue, reportArgumentType]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs | inner:
            said = node.value
        else:
            continue
        found = OPTION.search(said)
        if found and not re.search(COMMAND, said[: found.start()]):
            yield node.lineno, said


LIBRARY = [
    file
    for file in sorted(SOURCE.rglob("*.py"))
    if not file.relative_to(SOURCE).as_posix().startswith(("cli.py", "commands/", *OF_COMPILERS, *SAID_AT_A_TERMINAL))
]


def test_library_texts_contain_no_command_line_options():
    wrong = [
        f"{file.relative_to(SOURCE)}:{line}: {said}"
        for file in LIBRARY
        for line, said in option_texts(file.read_text("utf-8"))
        if not said.startswith(("--target=wasm32", "-Wl", "Faults, written as after --fault"))
    ]
    assert not wrong, "say argument(…), core/errors.py:\n" + "\n".join(wrong)


@pytest.mark.parametrize(
    "text",
    ['fix = "--seed 0"', 'fix = f"try {x} --set {y}=1"', 'fix = f"--{name} 3"', "raise InputError('--runs', 'x')"],
)
def test_detects_options_in_texts(text):
    assert list(option_texts(text))


@pytest.mark.parametrize("text", ['"""As after --set."""', 'fix = "trimtab run X --out DIR"', 'x = "-Wl,--entry=y"'])
def test_ignores_allowed_texts(text):
    assert not list(option_texts(text))


CASES = [
    (("runs", 1000), "runs=1000", "--runs 1000"),
    (("success", ["peak:yaw_rate <= 4"]), 'success=["peak:yaw_rate <= 4"]', "--success 'peak:yaw_rate <= 4'"),
    (("faults", ["a", "b c"]), 'faults=["a", "b c"]', "--fault a --fault 'b c'"),
    (("settings", "3.2", "a.mass"), 'settings={"a.mass": "3.2"}', "--set a.mass=3.2"),
    (("settings", "20 ms", "a.period"), 'settings={"a.period": "20 ms"}', "--set a.period='20 ms'"),
    (("settings", "[1,2]", "x[0]"), 'settings={"x[0]": "[1,2]"}', "--set 'x[0]=[1,2]'"),
    (("spread", "normal(100%, 5%)", "m"), 'spread={"m": "normal(100%, 5%)"}', "--spread 'm=normal(100%, 5%)'"),
    (("theory", False), "theory=False", "--no-theory"),
    (("direct", True), "direct=True", "--direct"),
    (("log_limit", None), "log_limit", "--log-limit"),
    (("settings", None, "world.vehicle.mass"), "settings world.vehicle.mass", "--set world.vehicle.mass"),
]


@pytest.mark.parametrize(("given", "python", "option"), CASES)
def test_argument_is_spelled_for_python_or_command_line(given, python, option):
    assert argument(*given) == python
    with spell_with(spell_option):
        assert argument(*given) == option
        with spell_with(lambda outer, *rest: outer(*rest).upper()):
            assert argument(*given) == option.upper()
    assert argument(*given) == python


def test_spelling_is_restored_after_error():
    with pytest.raises(InputError, match="--set x"), spell_with(spell_option):
        raise unknown_setting("settings", "x", ["y"])
    assert argument_name("settings", "x") == "settings x"


def test_renamed_options_exist_in_verbs():
    verbs = "".join(file.read_text("utf-8") for file in (SOURCE / "commands").glob("*.py") if file.stem != "verbs")
    assert [option for option in OPTIONS.values() if f'"{option}"' not in verbs and f'("{option}' not in verbs] == []
