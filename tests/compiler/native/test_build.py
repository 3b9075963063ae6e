"""Text to library: what goes wrong with compilers, disks and other processes."""

import ctypes
import os
import pickle
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from trimtab.compiler.native import build as module
from trimtab.compiler.native.build import FLAGS, BuildError, build_library, compiler_flags, load_library
from trimtab.compiler.native.cache import cache_problem

pytestmark = [
    pytest.mark.usefixtures("cache"),
    pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("g++")), reason="no gcc and g++ here"),
]

TWICE = "double twice(double x) { return 2.0 * x; }\n"
TWICE_CPP = 'extern "C" double twice(double x) { return 2.0 * x; }\n'
TEXT = {"c": TWICE, "c++": TWICE_CPP}


def twice(path: Path) -> float:
    function = load_library(path).twice
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return function(21.0)


def compiled(script: Path) -> list[str]:
    """The calls that compiled a program."""
    return [line for line in Path(f"{script}.log").read_text().splitlines() if " program.c" in line]


def manifest(library: Path) -> dict[str, str]:
    return dict(line.split(" ", 1) for line in library.with_suffix(".txt").read_text().splitlines())


def kind_of(library: Path) -> str:
    return "clang" if "clang" in manifest(library)["compiler"] else "gcc"


@pytest.mark.parametrize("language", ["c", "c++"])
def test_builds_once_and_caches_the_library(fake, cache: Path, language: str) -> None:
    script = fake(language=language)
    library = build_library(TEXT[language], language)
    assert library.parent == cache
    assert twice(library) == 42.0
    assert build_library(TEXT[language], language) == library
    assert len(compiled(script)) == 1
    assert set(compiler_flags(language, kind_of(library))) <= set(compiled(script)[0].split())
    assert cache_problem() == ""
    assert {path.suffix for path in cache.iterdir()} == {".so", ".txt", ".note"}, "left-overs"


def test_gcc_schedules_lane_code_before_register_allocation() -> None:
    assert {"-fschedule-insns", "-fsched-pressure"} <= set(compiler_flags("c++", "gcc"))
    assert compiler_flags("c", "gcc") == compiler_flags("c", "clang")
    assert not {flag for flag in compiler_flags("c++", "clang") if "sched" in flag}


@pytest.mark.parametrize("language", ["c", "c++"])
def test_cache_key_includes_compiler_flags(fake, monkeypatch: pytest.MonkeyPatch, language: str) -> None:
    fake(language=language)
    library = build_library(TEXT[language], language)
    which = "GCC_FLAGS" if kind_of(library) == "gcc" else "FLAGS"
    monkeypatch.setitem(getattr(module, which), language, (*getattr(module, which)[language], "-DX=1"))
    other = build_library(TEXT[language], language)
    assert other != library
    assert "-DX=1" in manifest(other)["flags"].split()


def test_cache_key_includes_text_flags_language_compiler_cpu(fake, monkeypatch: pytest.MonkeyPatch) -> None:
    fake()
    libraries = [
        build_library(TWICE),
        build_library(TWICE + " "),
        build_library(TWICE, extra=("-DX=1",)),
        build_library(TWICE, "c++"),
    ]
    monkeypatch.setattr(module, "cpu_identity", lambda: "another")
    libraries.append(build_library(TWICE))
    monkeypatch.undo()
    fake(always="""[ "$1" = --version ] && { "$REAL" --version | sed 's/^/my /'; exit; }""")
    libraries.append(build_library(TWICE))
    assert len(set(libraries)) == len(libraries)


def test_extra_libraries_follow_the_source_file(fake) -> None:
    script = fake()
    build_library(TWICE, extra=("-DNAME=1", "-lpthread"))
    words = compiled(script)[0].split()
    assert words.index("program.c") < words.index("-lpthread")


def test_flags_forbid_fma_and_wrap_signed_overflow() -> None:
    """No fused multiply-add, signed overflow wraps: what the flags are for, seen in what the code does."""
    text = """
    #include <stdint.h>
    double fused(double a, double b, double c) { return a * b + c; }
    int32_t grows(int32_t x) { return x + 1 > x; }
    """
    library = load_library(build_library(text))
    library.fused.restype, library.fused.argtypes = ctypes.c_double, [ctypes.c_double] * 3
    a = 1.0 + 2.0**-30
    assert library.fused(a, a, -(a * a)) == 0.0  # fused, it is 2^-60
    assert library.grows(2**31 - 1) == 0


def test_vectors_select_like_scalars() -> None:
    text = """
    typedef double vf64 __attribute__((vector_size(64)));
    extern "C" void positive(const double *x, double *y) {
        const vf64 v = *(const vf64 *)x, zero = {};
        *(vf64 *)y = v > zero ? v : zero;
    }
    """
    buffer = (ctypes.c_double * 24)()
    start = -ctypes.addressof(buffer) % 64 // 8  # vectors lie at multiples of their size
    x = (ctypes.c_double * 8).from_buffer(buffer, 8 * start)
    y = (ctypes.c_double * 8).from_buffer(buffer, 8 * start + 64)
    x[:] = [-1.0, 2.0, -3.0, 4.0, 5.0, -6.0, 7.0, 0.0]
    load_library(build_library(text, "c++")).positive(x, y)
    assert list(y) == [0.0, 2.0, 0.0, 4.0, 5.0, 0.0, 7.0, 0.0]


def test_compile_error_shows_first_lines_and_leaves_no_files(cache: Path) -> None:
    text = "\n".join(f"int f{k}(void) {{ return missing{k}; {400 * ';'} }}" for k in range(60))
    with pytest.raises(BuildError) as refused:
        build_library(text)
    said = str(refused.value)
    assert "missing0" in said
    assert "missing59" not in said
    assert len(said.splitlines()) <= 20 + 4
    assert max(map(len, said.splitlines())) <= 200
    assert "gcc" in said
    assert "Fix:" in said
    assert {path.suffix for path in cache.iterdir()} <= {".note"}
    assert isinstance(pickle.loads(pickle.dumps(refused.value)), BuildError)


HALF = '"$REAL" "$@"; size=$(wc -c <program.so); head -c $((size / 2)) program.so >half; mv half program.so'


@pytest.mark.parametrize(
    ("program", "words"),
    [
        (f"{HALF}; kill -9 $$", "killed by signal 9"),
        ("echo 'gcc: fatal error: Killed signal terminated program cc1' >&2; exit 1", "was killed"),
        ("sleep 60", "did not end within 0.5 s"),
        ("exit 0", "built no library"),
        ("echo odd >program.so; exit 0", "built no library"),
        (f"{HALF}; exit 0", "built no library"),
        ("echo broken; exit 4", "status 4:\n    broken"),
    ],
)
def test_failing_compiler_is_an_error_and_never_a_library(
    fake, cache: Path, monkeypatch: pytest.MonkeyPatch, program: str, words: str
) -> None:
    if program.startswith("sleep"):
        monkeypatch.setattr(module, "TIME_LIMIT", 0.5)
    script = fake(program)
    with pytest.raises(BuildError) as failed:
        build_library(TWICE)
    assert words in str(failed.value)
    assert str(script) in str(failed.value)
    assert {path.suffix for path in cache.iterdir()} == {".note"}, "left-overs"
    monkeypatch.setattr(module, "TIME_LIMIT", 60.0)
    monkeypatch.delenv("CC")
    assert twice(build_library(TWICE)) == 42.0


def refusing(flag: str) -> str:
    """A compiler that knows no such flag."""
    return f"""for word in "$@"; do [ "$word" = {flag} ] && {{ echo "unknown {flag}" >&2; exit 1; }}; done"""


@pytest.mark.parametrize("flag", ["-march=native", "-fno-tree-slp-vectorize", "-fno-math-errno"])
def test_old_compiler_works_without_optimisation_flags(fake, flag: str) -> None:
    fake(always=refusing(flag))
    library = build_library(TWICE)
    assert twice(library) == 42.0
    assert manifest(library)["flags"].split() == [word for word in FLAGS["c"] if word != flag]


def test_old_assembler_works_without_march_native(fake) -> None:
    fake(program=refusing("-march=native"))  # the flag passes, the program's instructions don't
    library = build_library(TWICE)
    assert twice(library) == 42.0
    assert "-march=native" not in manifest(library)["flags"]


def test_falls_back_to_the_older_standard_name(fake) -> None:
    fake(always=refusing("-std=c++17"), language="c++")
    library = build_library(TWICE_CPP, "c++")
    assert twice(library) == 42.0
    assert manifest(library)["flags"].split()[0] == "-std=c++1z"


def test_too_old_compiler_error_names_required_version(fake) -> None:
    version = """[ "$1" = --version ] && { echo 'g++ (GCC) 4.6.3'; echo Free Software Foundation; exit; }"""
    script = fake(always="\n".join([version, refusing("-std=c++17"), refusing("-std=c++1z")]), language="c++")
    with pytest.raises(BuildError) as failed:
        build_library(TWICE_CPP, "c++")
    for words in (str(script), "4.6.3", "too old", "-std=c++17", "gcc 8, clang 10 or newer"):
        assert words in str(failed.value)


@pytest.mark.parametrize("flag", ["-ffp-contract=off", "-fwrapv", "-std=c99"])
def test_rejects_compiler_without_a_numerics_flag(fake, flag: str) -> None:
    script = fake()
    build_library("int first;")
    times = script.stat()
    script.write_text(script.read_text().replace(":\n\n;;", ":\n;;").replace("exec", f"{refusing(flag)}\nexec"))
    os.utime(script, ns=(times.st_atime_ns, times.st_mtime_ns))  # replaced behind the process's back
    with pytest.raises(BuildError, match=f"too old: it rejects {flag}"):
        build_library(TWICE)


FULL = "echo 'fatal error: error writing to x.s: No space left on device' >&2; exit 1"


def test_full_cache_falls_back_to_a_private_folder(fake, cache: Path) -> None:
    fake(f'case "$PWD" in "$TRIMTAB_CACHE"*) {FULL};; esac')
    library = build_library(TWICE)
    assert library.parent != cache
    assert twice(library) == 42.0
    assert build_library(TWICE) == library, "built again in the same process"
    assert "No space" in cache_problem()


def test_full_disk_error_suggests_trimtab_cache(fake, cache: Path) -> None:
    fake(FULL)
    with pytest.raises(BuildError, match="No space left on device") as failed:
        build_library(TWICE)
    assert "TRIMTAB_CACHE" in failed.value.fix
    assert {path.suffix for path in cache.iterdir()} == {".note"}


def test_file_in_place_of_the_cache_uses_private_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "file"))
    (tmp_path / "file").write_text("")
    assert twice(build_library(TWICE)) == 42.0
    assert "file" in cache_problem()


def test_cache_that_others_can_write_to_is_not_used(cache: Path) -> None:
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    library = build_library(TWICE)
    assert twice(library) == 42.0
    assert list(cache.iterdir()) == []
    assert "others can write" in cache_problem()


@pytest.mark.skipif(os.getuid() == 0, reason="root may write everywhere")
def test_read_only_cache_is_still_read(cache: Path) -> None:
    library = build_library(TWICE)
    cache.chmod(0o500)
    assert build_library(TWICE) == library
    assert build_library("int other;").parent != cache


def test_builds_without_an_existing_temporary_folder(tmp_path: Path, cache: Path, monkeypatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "gone"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    assert build_library(TWICE).parent == cache


BUILD = f"""
import resource, sys
from trimtab.compiler.native.build import build_library
from trimtab.compiler.native.compiler import find_compiler
find_compiler()
if sys.argv[1:]:
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
print(build_library({TWICE!r}))
"""


def test_file_size_limit_raises_build_error(elsewhere, cache: Path) -> None:
    """The compiler itself fails to write: the library exceeds the file size limit."""
    process = elsewhere(BUILD.replace("sys.argv[1:]", "True"))
    _, trouble = process.communicate()
    assert process.returncode == 1
    assert "BuildError" in trouble
    assert "TRIMTAB_CACHE" in trouble.splitlines()[-1]
    assert {path.suffix for path in cache.iterdir()} == {".note"}


MOUNTED = """
import os, subprocess, sys
from trimtab.compiler.native.build import build_library, load_library
from trimtab.compiler.native.cache import cache_problem
mount = lambda *options: subprocess.run(("mount", *options, os.environ["TRIMTAB_CACHE"]), check=True)
mount("-t", "tmpfs", "-o", "size=64k,mode=700", "tmpfs")
build = "from trimtab.compiler.native.build import build_library"
elsewhere = build + "; print(build_library('int first(void) { return 1; }'))"
subprocess.run((sys.executable, "-c", elsewhere), check=True, stdout=subprocess.DEVNULL)
first = build_library("int first(void) { return 1; }")
filler = os.open(first.parent / "filler", os.O_CREAT | os.O_WRONLY)
try:
    while os.write(filler, bytes(4096)):
        pass
except OSError as full:
    print(full.strerror)
second = build_library("int second(void) { return 2; }")
print(load_library(second).second(), second.parent == first.parent, cache_problem())
os.truncate(filler, 0)
os.close(filler)
mount("-o", "remount,ro")
print(build_library("int first(void) { return 1; }") == first)
third = build_library("int third(void) { return 3; }")
print(load_library(third).third(), third.parent == first.parent, cache_problem())
mount("-o", "remount,rw,noexec")
fourth = build_library("int fourth(void) { return 4; }")
print(load_library(fourth).fourth(), fourth.parent == first.parent, cache_problem())
"""


def test_builds_on_full_read_only_and_noexec_file_systems(elsewhere, tmp_path: Path) -> None:
    own = ("unshare", "--mount")
    (tmp_path / "cache").mkdir()
    trial = [*own, "mount", "-t", "tmpfs", "tmpfs", str(tmp_path / "cache")]
    if shutil.which("unshare") is None or subprocess.run(trial, capture_output=True).returncode:
        pytest.skip("no permission to mount file systems")
    process = elsewhere(MOUNTED, *own)
    said, trouble = process.communicate()
    assert process.returncode == 0, trouble
    full, second, found, third, fourth = said.splitlines()
    assert full == "No space left on device"
    assert second.startswith("2 False")
    assert "No space left" in second
    assert found == "True"
    assert third.startswith("3 False")
    assert "Read-only" in third
    assert fourth.startswith("4 False")
    assert "noexec" in fourth


@pytest.mark.real_time
def test_concurrent_processes_compile_once(fake, elsewhere, cache: Path) -> None:
    script = fake("sleep 0.5")
    processes = [elsewhere(BUILD) for _ in range(3)]
    libraries = set()
    for process in processes:
        said, trouble = process.communicate()
        assert process.returncode == 0, trouble
        libraries.add(said.strip())
    assert len(libraries) == 1
    assert len(compiled(script)) == 1
    assert twice(Path(libraries.pop())) == 42.0
    assert len(list(cache.glob("*.so"))) == len(list(cache.glob("*.txt"))) == 1
    assert not list(cache.glob("*.lock"))


@pytest.mark.real_time
def test_processes_without_locks_end_with_one_entry(fake, elsewhere, cache: Path) -> None:
    fake("sleep 0.5")
    unlocked = "import contextlib\nimport trimtab.compiler.native.build as b\n"
    unlocked += "b.lock_key = lambda *_: contextlib.nullcontext()\n"
    processes = [elsewhere(unlocked + BUILD) for _ in range(3)]
    assert {process.communicate()[0].strip() for process in processes} == {str(build_library(TWICE))}
    assert len(list(cache.glob("*.so"))) == 1


@pytest.mark.real_time
def test_killed_build_does_not_block_the_next(fake, elsewhere, cache: Path) -> None:
    script = fake('[ -e "$0.slow" ] && { rm "$0.slow"; echo half >program.so; exec sleep 5; }')
    slow = Path(f"{script}.slow")
    slow.write_text("")
    process = elsewhere(BUILD)
    until = time.monotonic() + 20.0
    while slow.exists() and time.monotonic() < until:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    began = time.monotonic()
    assert twice(build_library(TWICE)) == 42.0
    assert time.monotonic() - began < 3.0, "waited for a dead process"
    (left,) = cache.glob("tmp-*")
    os.utime(left, (0, 0))
    build_library("int another;")
    assert not left.exists()


@pytest.mark.parametrize("damage", [b"", b"\x7fELF", b"garbage"])
def test_damaged_entry_is_built_again(fake, damage: bytes) -> None:
    script = fake()
    library = build_library(TWICE)
    library.write_bytes(damage)
    assert build_library(TWICE) == library
    assert len(compiled(script)) == 2
    assert twice(library) == 42.0


def test_unloadable_library_raises_build_error(tmp_path: Path) -> None:
    (tmp_path / "odd.so").write_text("odd")
    with pytest.raises(BuildError, match="cannot be loaded"):
        load_library(tmp_path / "odd.so")
