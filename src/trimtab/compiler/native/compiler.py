"""The machine's C and C++ compilers: search, identity, and vector width for this CPU.

A compiler is run with a time limit, and writes its files to a temporary folder.
"""

import contextlib
import errno
import functools
import os
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from trimtab.compiler.native.cache import (
    MAKE_ROOM_FIX,
    cached_library_folder,
    read_private_file,
    try_folders,
    work_folder,
    write_atomically,
)
from trimtab.core.errors import InputError

NO_ROOM_MESSAGES = (
    "No space left on device",
    "Disk quota exceeded",
    "Read-only file system",
    "File too large",
    "File size limit exceeded",
)
KILL_MESSAGES = ("Killed signal terminated", "Terminated signal terminated", "unable to execute command: Killed")
"""Messages of gcc and clang if a program that they started was killed. Their exit status does not show it."""


class CompilerOutcome(NamedTuple):
    """Result of running a compiler.

    Attributes:
        status: exit status; if negative, the signal that killed the compiler; None if it was stopped by the time limit.
        text: output of the compiler, or the reason why it was stopped.
    """

    status: int | None
    text: str

    @property
    def interruption(self) -> str:
        """Return the reason why the compiler did not finish, or "" if it did."""
        if self.status is None:
            return self.text
        if self.status < 0:
            return f"it was killed by signal {-self.status}"
        killed = self.status and any(words in self.text for words in KILL_MESSAGES)
        return "a child program was killed" if killed else ""


def run_compiler(command: tuple[str, ...], work: Path, limit: float) -> CompilerOutcome:
    """Run a command in a work folder, which is also used for its temporary files. Stop the command after `limit`
    seconds.

    Raises OSError if the folder cannot be written or its disk is full, so that the caller can try another folder.
    """
    outcome = _run_process(command, work, limit)
    for words in NO_ROOM_MESSAGES if outcome.status else ():
        if words in outcome.text:
            raise OSError(errno.ENOSPC, f"the compiler reported '{words}'", str(work.parent))
    return outcome


def _run_process(command: tuple[str, ...], work: Path, limit: float) -> CompilerOutcome:
    import signal
    import subprocess

    surroundings = {**os.environ, "LC_ALL": "C", "TMPDIR": str(work)}
    try:
        started = subprocess.Popen(
            command,
            cwd=work,
            env=surroundings,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as reason:
        return CompilerOutcome(127, f"it could not be started: {reason}")
    try:
        said, _ = started.communicate(timeout=limit)
        return CompilerOutcome(started.returncode, said.decode("utf-8", "replace"))
    except subprocess.TimeoutExpired:
        return CompilerOutcome(None, f"it did not end within {limit:g} s")
    finally:
        if started.returncode is None:  # stop it with all its children, also if this process is interrupted
            os.killpg(started.pid, signal.SIGKILL)
            started.wait()
        if started.stdout:
            started.stdout.close()


NAMES = {"c": ("CC", "gcc", "clang", "cc"), "c++": ("CXX", "g++", "clang++", "c++")}
"""Language -> environment variable that names a compiler, and the compilers tried if the variable is not set."""
SUFFIX = {"c": "c", "c++": "cpp"}
REQUIRED = {"c": ("-std=c99", "-ffp-contract=off", "-fwrapv"), "c++": ("-ffp-contract=off", "-fwrapv")}
"""Flags without which results could differ. A compiler that rejects one of them cannot be used."""
NEEDED_VERSIONS = "gcc 8, clang 10 or newer"
INSTALL = {
    "c": "install gcc (Debian: apt install gcc libc6-dev; Fedora: dnf install gcc; macOS: xcode-select --install)",
    "c++": "install g++ (Debian: apt install g++; Fedora: dnf install gcc-c++; macOS: xcode-select --install)",
}
PROBE = {
    "c": "#include <math.h>\ndouble probe(double x) { return floor(x) + 1.0; }\n",
    "c++": '#include <cmath>\nextern "C" double probe(double x) { return std::floor(x) + 1.0; }\n',
}
PROBE_LIMIT = 30.0
"""Maximum duration (s) of the compilation that tests a compiler."""


class NoCompilerError(InputError):
    """Error: no compiler works. The message lists the compilers tried and the package to install."""


class Compiler(NamedTuple):
    """Compiler that was tried and works.

    Attributes:
        path: the executable.
        kind: ``gcc`` or ``clang``.
        version: version number, e.g. (12, 2, 0).
        identity: first line of ``--version``, target and options. Together with flags and CPU, it determines the code.
        options: words after the executable, if CC has several words, such as ``ccache gcc``.
        width: number of doubles in a vector, if compiled for this CPU.
    """

    path: str
    kind: str
    version: tuple[int, ...]
    identity: str
    options: tuple[str, ...] = ()
    width: int = 1


class CompilerSearch(NamedTuple):
    """Result of the search for a compiler: the compiler, or the reasons why none works and the fix."""

    compiler: Compiler | None
    problem: str = ""
    fix: str = ""


def find_compiler(language: str = "c") -> Compiler | None:
    """Return the compiler for ``c`` or ``c++``: CC or CXX, else gcc, clang or cc. Return None if none works.

    A compiler works if it makes a shared library that loads and computes the right number. The result is cached. The
    next process only checks that the executable is still the same.
    """
    return search_compiler(language).compiler


def search_compiler(language: str) -> CompilerSearch:
    """Return the compiler as `find_compiler` does, or the reasons why none works."""
    if language not in NAMES:
        raise InputError("build", f"unknown language {language!r}", choices=NAMES)
    try:
        return _search_on_path(language, os.environ.get(NAMES[language][0], ""), os.environ.get("PATH", os.defpath))
    except OSError as reason:
        return CompilerSearch(None, f"no folder is available to try compilers: {reason}", MAKE_ROOM_FIX)


def lane_count(compiler: Compiler) -> int:
    """Return the number of lanes for this CPU: 8 with AVX-512 F, DQ and VL, 4 with AVX2, else 1."""
    return compiler.width


@functools.cache
def cpu_identity() -> str:
    """Return an identity of the CPU's model and features. Code built for one CPU is not run on another."""
    for source in ("/sys/devices/system/cpu/modalias", "/proc/cpuinfo"):
        try:
            content = Path(source).read_bytes()
        except OSError:
            continue
        changing = (b"processor", b"cpu MHz", b"bogomips", b"BogoMIPS")
        lines = content.split(b"\n\n")[0].splitlines()
        if features := b"\n".join(line for line in lines if not line.startswith(changing)):
            return f"{os.uname().machine} {sha256(features).hexdigest()[:32]}"
    import platform

    return f"{platform.machine()} {platform.processor()}"


@functools.cache
def _search_on_path(language: str, wished: str, path: str) -> CompilerSearch:
    variable, *usual = NAMES[language]
    candidates = [_split_command(wished)] if wished.strip() else []
    reasons: list[str] = []
    for words in dict.fromkeys([*candidates, *((name,) for name in usual)]):
        executable, name = _find_executable(words[0], path), " ".join(words)
        if executable is None:
            reasons.append(f"{name}: not found")
            continue
        note = f"compiler-{_cache_key(executable, words, language, path)}.note"
        found = _load_from_cache(note, executable, words)
        if found is None:
            found = try_folders(functools.partial(_try_compiler, executable, words[1:], language))
            _save_to_cache(note, found)
        if isinstance(found, Compiler):
            return CompilerSearch(found)
        reasons.append(f"{name}: {found}")
    problem = f"no {language.upper()} compiler works here ({'; '.join(reasons)})"
    return CompilerSearch(None, problem, f"{INSTALL[language]}, or name one in {variable}.")


def _split_command(wished: str) -> tuple[str, ...]:
    """Return the words of the environment variable CC or CXX, which may include options, as in 'ccache gcc'."""
    import shlex

    try:
        return tuple(shlex.split(wished))
    except ValueError:  # an unterminated quote
        return (wished,)


def _find_executable(name: str, path: str) -> str | None:
    folders = [""] if os.sep in name else filter(None, path.split(os.pathsep))
    for candidate in (os.path.abspath(os.path.join(folder, name)) for folder in folders):
        if os.path.isfile(candidate) and os.access(candidate, os.X_OK):
            return candidate
    return None


def _cache_key(executable: str, words: tuple[str, ...], language: str, path: str) -> str:
    """Return a cache key that changes if the compiler's executable or the CPU changes."""
    parts = [language, cpu_identity(), *words]
    for file in filter(None, [executable, *(_find_executable(word, path) for word in words[1:])]):
        about = os.stat(file)
        parts += [file, str(about.st_mtime_ns), str(about.st_size)]
    return sha256("\0".join(parts).encode()).hexdigest()[:32]


def _load_from_cache(note: str, executable: str, words: tuple[str, ...]) -> Compiler | None:
    try:
        content = read_private_file(cached_library_folder() / note) or b""
        kind, version, width, identity, end = content.decode().splitlines()
        numbers = tuple(int(number) for number in version.split("."))
        return Compiler(executable, kind, numbers, identity, words[1:], int(width)) if end == "end" else None
    except (OSError, ValueError):
        return None


def _save_to_cache(note: str, found: Compiler | str) -> None:
    if isinstance(found, Compiler):
        lines = (found.kind, ".".join(map(str, found.version)), str(found.width), found.identity, "end")
        with contextlib.suppress(OSError):  # if it fails, the next process tests the compiler again
            write_atomically(cached_library_folder() / note, "\n".join(lines))


def _try_compiler(executable: str, options: tuple[str, ...], language: str, folder: Path) -> Compiler | str:
    """Test a compiler. Return it, or the reason why it cannot be used."""
    with work_folder(folder) as work:
        said = run_compiler((executable, *options, "--version"), work, PROBE_LIMIT)
        first = said.text.strip().splitlines()[:1]
        kind = "clang" if "clang version" in said.text else "gcc" if "Free Software Foundation" in said.text else ""
        if said.status or said.interruption or not first:
            return said.interruption or f"--version gives status {said.status}, '{said.text.strip()[:200]}'"
        if not kind:
            return f"neither gcc nor clang, but '{first[0]}'"
        if unfit := _find_defect((executable, *options), language, work):
            return f"{first[0]}: {unfit}"
        target = run_compiler((executable, *options, "-dumpmachine"), work, PROBE_LIMIT).text.strip().splitlines()[:1]
        identity = " ".join([*first, *target, *options])
        width = _vector_width((executable, *options), language, work)
        return Compiler(executable, kind, _parse_version(first[0]), identity, options, width)


def _find_defect(command: tuple[str, ...], language: str, work: Path) -> str:
    """Return the reason why a compiler cannot build a library that computes the right number, or "" if it can."""
    import ctypes

    source, library = f"probe.{SUFFIX[language]}", work / "probe.so"
    (work / source).write_text(PROBE[language])
    arguments = (*REQUIRED[language], "-shared", "-fPIC", "-o", library.name, source, "-lm")
    said = run_compiler((*command, *arguments), work, PROBE_LIMIT)
    if said.status or said.interruption:
        why = said.interruption or " ".join(said.text.split())[:300]
        return f"it cannot make a library with {' '.join(REQUIRED[language])} ({why}); {NEEDED_VERSIONS} is needed"
    try:
        probe = ctypes.CDLL(str(library)).probe
    except (OSError, AttributeError) as reason:
        return f"its library cannot be loaded ({reason})"
    probe.restype, probe.argtypes = ctypes.c_double, [ctypes.c_double]
    return "" if probe(41.5) == 42.0 else "its library computes wrong numbers"


def _vector_width(command: tuple[str, ...], language: str, work: Path) -> int:
    arguments = ("-march=native", "-dM", "-E", "-x", language, os.devnull)
    said = run_compiler((*command, *arguments), work, PROBE_LIMIT)
    has = set(said.text.split()) if said.status == 0 else set()
    return 8 if {"__AVX512F__", "__AVX512DQ__", "__AVX512VL__"} <= has else 4 if "__AVX2__" in has else 1


def _parse_version(line: str) -> tuple[int, ...]:
    """Return the version number in a line such as 'gcc (Debian 12.2.0-14) 12.2.0', without the part in brackets."""
    import re

    found = re.search(r"\s(\d+(?:\.\d+)+)", re.sub(r"\([^)]*\)", "", line))
    return tuple(int(number) for number in found[1].split(".")) if found else (0,)
