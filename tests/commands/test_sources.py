"""Which files a run was made from: a program of the user's with a module, a package and a trace beside it."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from trimtab.commands.sources import PACKAGE, fingerprint, list_package_files, record_read_files, sha256

PROGRAM = """
import sys
from trimtab.commands.sources import files_read, loaded_files
with files_read() as read:
    import colorsys, json, numpy as np
    import hulls.light
    from trimtab.scenarios import catalogue
    boat, _ = catalogue.load("boat.py:scenario")
    with open("/dev/null") as nothing, open("written.txt", "w") as out:
        nothing.read()
    try:
        open("missing.txt")
    except FileNotFoundError:
        pass
print("\\n".join(loaded_files()))
print("--")
print("\\n".join(sorted(read)))
"""


def test_files_of_the_user_are_told_from_those_of_python_packages_and_trimtab(tmp_path):
    (tmp_path / "hulls").mkdir()
    (tmp_path / "hulls" / "__init__.py").write_text("")
    (tmp_path / "hulls" / "light.py").write_text("MASS = 2.6\n")
    (tmp_path / "trace.csv").write_text("1,2\n")
    reads = "import numpy as np\ndef scenario(): return np.loadtxt('trace.csv', delimiter=',')\n"
    (tmp_path / "boat.py").write_text(reads)
    (tmp_path / "main.py").write_text(PROGRAM)
    environment = os.environ | {"PYTHONPATH": str(Path(PACKAGE).parent)}
    words = [sys.executable, "main.py"]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    loaded, read = ([Path(line).name for line in half.split()] for half in done.stdout.split("--"))
    assert loaded == ["boat.py", "__init__.py", "light.py", "main.py"]
    assert {"trace.csv", "missing.txt"} <= set(read)
    assert set(read) <= {"trace.csv", "missing.txt", "boat.py", "__init__.py", "light.py"}


def test_reading_is_seen_only_meanwhile_and_by_all_who_look(tmp_path):
    names = [tmp_path / name for name in ("before", "outer", "both", "after")]
    for name in names:
        np.save(name, np.zeros(1))
    files = [f"{name}.npy" for name in names]
    with open(files[0]):
        pass
    with record_read_files() as outer:
        np.load(files[1])
        with record_read_files() as inner:
            np.load(files[2])
    os.close(os.open(files[3], os.O_RDONLY))
    assert outer == {files[1], files[2]}
    assert inner == {files[2]}


def test_reading_is_given_also_after_an_error(tmp_path):
    (tmp_path / "a").write_text("")

    def fail():
        with record_read_files() as found:
            seen.append(found)
            os.close(os.open(tmp_path / "a", os.O_RDONLY))
            os.close(os.open(tmp_path / "b", os.O_WRONLY | os.O_CREAT))
            raise RuntimeError

    seen = []
    with pytest.raises(RuntimeError):
        fail()
    assert seen == [{str(tmp_path / "a")}]


def test_package_files_are_all_of_the_source_and_nothing_compiled():
    files = list_package_files()
    names = {os.path.relpath(f, PACKAGE) for f in files}
    assert {"cli.py", "core/record.py", "scenarios/hovercraft/spin.py", "commands/sources.py"} <= names
    assert not [n for n in names if n.endswith(".pyc") or "__pycache__" in n]
    assert files == sorted(files)


def test_fingerprint_changes_with_contents_and_names_not_with_order(tmp_path):
    a, b, c = (str(tmp_path / n) for n in "abc")
    for name, text in ((a, "1"), (b, "2"), (c, "1")):
        Path(name).write_text(text)
    first = fingerprint([a, b])
    assert fingerprint([b, a]) == first
    assert len({first, fingerprint([a]), fingerprint([c, b]), fingerprint([])}) == 4
    Path(b).write_text("3")
    assert fingerprint([a, b]) != first
    with pytest.raises(OSError):
        fingerprint([str(tmp_path / "none")])


def test_sha256_is_that_of_the_contents(tmp_path):
    (tmp_path / "abc").write_text("abc")  # the example of FIPS 180-4
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256(str(tmp_path / "abc")) == expected
