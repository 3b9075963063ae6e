"""Finding a compiler, and remembering it."""

import os
import pickle
import shutil
from pathlib import Path

import pytest

from trimtab.compiler.native import compiler as module
from trimtab.compiler.native.build import build_library
from trimtab.compiler.native.compiler import NoCompilerError, cpu_identity, find_compiler, lane_count, search_compiler
from trimtab.core.errors import InputError

pytestmark = [
    pytest.mark.usefixtures("cache"),
    pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("g++")), reason="no gcc and g++ here"),
]


def calls(script: Path) -> list[str]:
    log = Path(f"{script}.log")
    return log.read_text().splitlines() if log.exists() else []


def forget() -> None:
    """As in a new process."""
    module._search_on_path.cache_clear()


@pytest.mark.parametrize(("language", "name"), [("c", "gcc"), ("c++", "g++")])
def test_finds_the_default_gcc(language: str, name: str) -> None:
    found = find_compiler(language)
    assert found is not None
    assert Path(found.path).name == name
    assert found.kind == "gcc"
    assert found.version >= (8,)
    assert ".".join(map(str, found.version)) in found.identity
    assert "linux" in found.identity


def test_cc_variable_takes_precedence_and_may_hold_options(fake, monkeypatch: pytest.MonkeyPatch) -> None:
    script = fake()
    monkeypatch.setenv("CC", f"{script} -O1 '-DNAME=two words'")
    found = find_compiler()
    assert found is not None
    assert (found.path, found.options) == (str(script), ("-O1", "-DNAME=two words"))
    assert "-O1" in found.identity
    assert all(line.startswith("-O1 -DNAME=two words ") for line in calls(script))


def test_compiler_is_probed_again_only_if_changed(fake) -> None:
    script = fake()
    first = find_compiler()
    asked = len(calls(script))
    assert asked > 0
    forget()
    assert find_compiler() == first
    assert len(calls(script)) == asked, "asked again"
    os.utime(script, ns=(1, 1))
    forget()
    assert find_compiler() == first
    assert len(calls(script)) == 2 * asked, "a changed executable was not asked"


@pytest.mark.parametrize("damage", ["", "gcc\n12.2.0\n8\n", "gcc\nx\n8\nidentity\nend", "\xff"])
def test_damaged_note_is_rewritten(fake, cache: Path, damage: str) -> None:
    script = fake()
    first = find_compiler()
    (note,) = cache.glob("*.note")
    whole = note.read_bytes()
    note.write_text(damage, encoding="latin-1")
    forget()
    assert find_compiler() == first
    assert note.read_bytes() == whole
    assert len([line for line in calls(script) if "--version" in line]) == 2


@pytest.mark.parametrize(
    ("always", "reason"),
    [
        ("exit 1", "--version gives status 1"),
        ("kill -9 $$", "killed by signal 9"),
        ("echo tcc version 0.9.27; exit 0", "neither gcc nor clang, but 'tcc version 0.9.27'"),
        ('case "$*" in *probe*) echo ld: cannot find -lm; exit 1;; esac', "cannot find -lm"),
        ('case "$*" in *probe*) exit 0;; esac', "cannot be loaded"),
        ('case "$*" in *-ffp-contract*) echo unrecognized; exit 1;; esac', "gcc 8, clang 10 or newer is needed"),
        ('case "$*" in *probe*) sed -i s/1.0/2.0/ probe.c;; esac', "wrong numbers"),
    ],
)
def test_broken_compiler_is_skipped_with_the_reason(
    fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, always: str, reason: str
) -> None:
    fake(always=always)
    instead = find_compiler()
    assert instead is not None
    assert Path(instead.path).name == "gcc"
    monkeypatch.setattr(module, "NAMES", {"c": ("CC",)})
    forget()
    assert reason in search_compiler("c").problem


def test_hanging_compiler_is_stopped(fake, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(always="sleep 60")
    monkeypatch.setattr(module, "PROBE_LIMIT", 0.3)
    monkeypatch.setattr(module, "NAMES", {"c": ("CC",)})
    assert "did not end within 0.3 s" in search_compiler("c").problem


def test_missing_compiler_error_lists_candidates_and_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "mycc 'unended")
    assert find_compiler() is None
    with pytest.raises(NoCompilerError) as refused:
        build_library("int nothing;")
    text = str(refused.value)
    for words in ("mycc 'unended: not found", "gcc: not found", "clang: not found", "cc: not found", "apt install gcc"):
        assert words in text
    assert isinstance(pickle.loads(pickle.dumps(refused.value)), NoCompilerError)


def test_rejects_language_other_than_c_or_cpp() -> None:
    with pytest.raises(InputError, match=r"c, c\+\+"):
        find_compiler("fortran")


@pytest.mark.parametrize(
    ("has", "width"),
    [("AVX2 AVX512F AVX512DQ AVX512VL", 8), ("AVX2 AVX512F AVX512DQ", 4), ("AVX2", 4), ("SSE2", 1), ("", 1)],
)
def test_lane_count_follows_compiler_macros(fake, has: str, width: int) -> None:
    said = "".join(f"#define __{name}__ 1\\n" for name in has.split())
    fake(always=f"""case "$*" in *-dM*) printf '{said}'; exit 0;; esac""")
    found = find_compiler()
    assert found is not None
    assert lane_count(found) == width
    forget()
    assert find_compiler() == found, "remembered otherwise"


def test_lane_count_is_one_without_march_native(fake) -> None:
    fake(always="""case "$*" in *-march=native*) echo 'bad value'; exit 1;; esac""")
    found = find_compiler()
    assert found is not None
    assert lane_count(found) == 1


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="no /proc/cpuinfo")
def test_lane_count_matches_this_cpu() -> None:
    lines = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("flags")]
    flags = set(lines[0].split()) if lines else set()
    found = find_compiler("c++")
    assert found is not None
    assert lane_count(found) == (8 if {"avx512f", "avx512dq", "avx512vl"} <= flags else 4 if "avx2" in flags else 1)


def test_cpu_identity_depends_on_features_not_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "processor\t: 0\nmodel\t: 1\ncpu MHz\t: {}\nflags\t: fpu {}\n\nprocessor\t: 1\ncpu MHz\t: 7\n"

    def identity(mhz: str, flag: str) -> str:
        def read(path: Path) -> bytes:
            if path.name == "modalias":
                raise FileNotFoundError(path)
            return text.format(mhz, flag).encode()

        monkeypatch.setattr(Path, "read_bytes", read)
        cpu_identity.cache_clear()
        return cpu_identity()

    assert identity("1", "avx2") == identity("2", "avx2")
    assert identity("1", "avx2") != identity("1", "avx512f")
    cpu_identity.cache_clear()


def test_cpu_identity_works_without_proc(monkeypatch: pytest.MonkeyPatch) -> None:
    def read(path: Path) -> bytes:
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_bytes", read)
    cpu_identity.cache_clear()
    assert os.uname().machine in cpu_identity()
    cpu_identity.cache_clear()


def test_error_without_any_folder_names_trimtab_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fake) -> None:
    fake()
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "my-gcc"))  # a file
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    with pytest.raises(NoCompilerError, match="TRIMTAB_CACHE"):
        build_library("int nothing;")


def test_importing_the_build_module_is_light(elsewhere) -> None:
    text = """
import sys
before = set(sys.modules)
from trimtab.compiler.native.build import build_library, load_library
from trimtab.compiler.native.compiler import find_compiler
load_library(build_library("int one(void) { return 1; }"))
print(*set(sys.modules) - before)
"""
    for _ in range(2):
        process = elsewhere(text)
        said, trouble = process.communicate()
        assert process.returncode == 0, trouble
    assert not {"jax", "numpy", "subprocess", "tempfile", "shutil", "json"} & set(said.split())
    assert "ctypes" in said.split()
