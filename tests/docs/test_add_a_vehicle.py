"""The commands of the how-to, run in order, print what the page shows.

tests/commands/test_every_verb.py checks commands that need two terminals or a browser.
"""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.compiler.native.compiler import find_compiler

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "add-a-vehicle.md").read_text(encoding="utf-8")
OF_SEVERAL_TERMINALS = ("vehicle", "fly", "inject", "console")


def read_commands():
    """(words of a command, lines that it is said to print) of the page's blocks, in their order."""
    found = []
    for block in re.findall(r"^```text\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL):
        for line in filter(None, block.splitlines()):
            if line.startswith("trimtab "):
                found.append((shlex.split(line)[1:], []))
            else:
                found[-1][1].append(line.strip())
    return found


def test_page_shows_every_verb_with_its_output():
    verbs = "run replay identify campaign budget map falsify rare tune trim linearise design export firmware"
    commands = read_commands()
    assert {words[0] for words, _ in commands} >= {*verbs.split(), *OF_SEVERAL_TERMINALS}
    assert "trimtab list" in PAGE
    assert all(shown for words, shown in commands if words[0] not in OF_SEVERAL_TERMINALS and "--emulate" not in words)


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_each_command_prints_what_the_page_says(tmp_path, monkeypatch):
    shutil.copy(ROOT / "examples" / "my_boat.py", tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TRIMTAB_CONFIG", str(tmp_path / "config"))
    monkeypatch.setenv("COLUMNS", "200")
    for words, shown in read_commands():
        if not shown:
            continue
        done = CliRunner().invoke(main, words)
        assert done.exit_code in ((0, 1) if words[0] == "falsify" else (0,)), (words, done.output)
        said = " ".join(done.output.split())
        for line in shown:
            assert " ".join(line.split()) in said, (words, done.output)
