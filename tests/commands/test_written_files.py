"""No verb overwrites a file that trimtab did not write."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.written_files import check_new, check_new_in, note_written, place_files
from trimtab.core.errors import InputError

SPIN = "hovercraft/spin"
MINE = b"something of my own\n"
SPREAD = ("--spread", "world.vehicle.mass=uniform(80%, 120%)")
HALL = str(Path(__file__).parents[2] / "examples" / "hall.toml")
WRITES = {
    "run --plot": (("run", SPIN, "--plot", "mine.png"), "mine.png"),
    "run --out": (("run", SPIN, "--out", "."), "run.mcap"),
    "run --out, its picture": (("run", SPIN, "--out", "."), "run.png"),
    "run, a second picture": (("run", SPIN, "--plot", "a.png"), "a-tracking.png"),
    "demo": (("demo",), "trimtab-demo.png"),
    "budget": (("budget", SPIN, "--plot", "mine.png"), "mine.png"),
    "campaign": (("campaign", SPIN, "--out", "."), "convergence.png"),
    "campaign's table": (("campaign", SPIN, "--out", "."), "campaign.parquet"),
    "falsify": (("falsify", SPIN, *SPREAD, "--out", "mine.py"), "mine.py"),
    "falsify --plot": (("falsify", SPIN, *SPREAD, "--plot", "mine.svg"), "mine.svg"),
    "tune": (("tune", SPIN, "--gain", "autopilot.law.braking.k1=1:2", "--out", "mine.py"), "mine.py"),
    "rare": (("rare", SPIN, *SPREAD, "--out", "."), "worst.py"),
    "map": (("map", SPIN, "--x", "delay=0:1", "--y", "loss=0:1", "--plot", "mine.pdf"), "mine.pdf"),
    "trim": (("trim", SPIN, "--out", "mine.json"), "mine.json"),
    "linearise": (("linearise", SPIN, "--out", "mine.json"), "mine.json"),
    "linearise --plot": (("linearise", SPIN, "--closed-loop", "--plot", "mine.png"), "mine.png"),
    "design": (("design", "hypersonic", "--out", "mine.json"), "mine.json"),
    "design's proof": (("design", "hypersonic", "--export-coq", "mine.v"), "mine.v"),
    "plan": (("plan", HALL, "--out", "mine.csv"), "mine.csv"),
    "plan --plot": (("plan", HALL, "--plot", "mine.png"), "mine.png"),
    "export --fmu": (("export", SPIN, "--fmu", "3", "--out", "mine.fmu"), "mine.fmu"),
    "export --wasm": (("export", SPIN, "--wasm", "--out", "."), "index.html"),
    "reproduce": (("reproduce", "hovercraft2006", "--report", "."), "index.html"),
    "link-test": (("link-test", "udp://127.0.0.1:9", "--out", "."), "link-test.json"),
    "vehicle": (("vehicle", SPIN, "--listen", "loopback://written-files", "--unsigned", "--out", "."), "vehicle.mcap"),
}
"""Verb -> what is typed, and the file of one's own that lies there."""
SLOW = ("export", "firmware")


@pytest.fixture(autouse=True)
def _own_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "cache"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")


def call(*words):
    return CliRunner().invoke(main, list(words))


@pytest.mark.parametrize(("words", "name"), WRITES.values(), ids=WRITES)
def test_foreign_file_is_never_overwritten(words, name):
    Path(name).write_bytes(MINE)
    done = call(*words)
    assert done.exit_code == 2, done.output
    assert name in done.stderr
    assert "Fix:" in done.stderr
    assert Path(name).read_bytes() == MINE
    assert [file.name for file in Path().iterdir()] == [name]


@pytest.mark.thorough
@pytest.mark.parametrize("words", [("export", SPIN), ("firmware", "hovercraft/forward")], ids=SLOW)
def test_export_into_existing_folder_keeps_foreign_files(words, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    more = ("--steps", "50") if words[0] == "export" else ()
    assert call(*words, *more, "--out", "board").exit_code == 0
    main_c = next(file for file in sorted(Path("board").rglob("*.c")))
    Path("board/notes.c").write_bytes(MINE)
    assert call(*words, *more, "--out", "board").exit_code == 0  # what it wrote itself is replaced
    assert Path("board/notes.c").read_bytes() == MINE
    main_c.write_bytes(MINE)
    done = call(*words, *more, "--out", "board")
    assert done.exit_code == 2, done.output
    assert main_c.name in done.stderr
    assert main_c.read_bytes() == MINE
    assert call(*words, *more, "--out", "board", "--overwrite").exit_code == 0
    assert main_c.read_bytes() != MINE


@pytest.mark.thorough
def test_own_output_is_overwritten_unless_edited():
    words = ("trim", "hovercraft/forward", "--at", "surge_velocity=1", "--at", "yaw_rate=0", "--out", "point.json")
    assert call(*words).exit_code == 0
    assert call(*words, "--json").exit_code == 0
    text = Path("point.json").read_text()
    Path("point.json").write_text(text + "\n")
    done = call(*words)
    assert done.exit_code == 2
    assert "edited since" in done.stderr
    assert "--overwrite" in done.stderr
    assert call(*words, "--overwrite").exit_code == 0
    assert Path("point.json").read_text() == text


def test_written_file_is_recognised_by_path_and_content():
    Path("a.txt").write_text("one")
    Path("b.txt").write_text("one")
    note_written(["a.txt"])
    check_new("--out", Path("a.txt"), Path("not-there.txt"), None)
    with pytest.raises(InputError, match="b\\.txt"):
        check_new("--out", Path("b.txt"))
    with pytest.raises(InputError, match="b\\.txt"):
        check_new_in("--out", Path(), "*.txt")
    check_new_in("--out", Path(), "a.*")


def test_files_are_placed_all_or_not_at_all(tmp_path):
    scratch, folder = tmp_path / "scratch", tmp_path / "folder"
    for where in (scratch / "sub", folder):
        where.mkdir(parents=True)
    (scratch / "a.c").write_text("new")
    (scratch / "sub" / "b.c").write_text("new")
    (folder / "a.c").write_bytes(MINE)
    files = [scratch / "sub" / "b.c", scratch / "a.c"]
    with pytest.raises(InputError, match=r"a\.c"):
        place_files("--out", scratch, files, folder)
    assert sorted(p.name for p in folder.rglob("*")) == ["a.c"]
    (folder / "a.c").unlink()
    assert [p.read_text() for p in place_files("--out", scratch, files, folder)] == ["new", "new"]
    check_new("--out", folder / "a.c")


def test_without_cache_no_file_is_overwritten(monkeypatch, tmp_path):
    (tmp_path / "no-folder").write_text("")
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "no-folder"))
    Path("a.txt").write_text("one")
    note_written(["a.txt"])
    with pytest.raises(InputError, match=r"a\.txt"):
        check_new("--out", Path("a.txt"))
