"""Build of C or C++ text to a shared library, once for each text, compiler and CPU. The library is cached."""

import functools
import os
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from trimtab.compiler.native.cache import (
    MAKE_ROOM_FIX,
    find_in_folder,
    find_library,
    lock_key,
    store_library,
    try_folders,
    work_folder,
)
from trimtab.compiler.native.compiler import (
    NEEDED_VERSIONS,
    REQUIRED,
    SUFFIX,
    Compiler,
    CompilerOutcome,
    NoCompilerError,
    cpu_identity,
    run_compiler,
    search_compiler,
)
from trimtab.core.errors import InputError

if TYPE_CHECKING:
    import ctypes

GENERATION = "1"
"""Part of every cache key. Increase this number when libraries in the cache must not be used again."""
COMMON = (
    *("-O2", "-march=native", "-ffp-contract=off", "-fwrapv", "-fno-math-errno"),
    *("-fno-tree-slp-vectorize", "--param=vect-epilogues-nomask=0"),
)
"""Compiler flags for both languages.

The vectoriser of straight-line code (SLP) is off, because it fuses products and sums (vfmaddsub) even with
-ffp-contract=off. The last flag keeps gcc from vectorising the remainder of a vectorised loop. In such a remainder, gcc
12 assumes an alignment of 32 bytes for arrays on the stack that are aligned to 16, and the program crashes with SIGSEGV
(`TightlyCoupled`, 28 beacons, AVX-512)."""
FLAGS = {
    "c": (
        "-std=c99",
        *COMMON,
        "-ftree-loop-vectorize",
        "-fvect-cost-model=dynamic",
        "-fpeel-loops",
        "-DTT_NO_SLP",
        "--param=max-inline-insns-single=200",
    ),
    "c++": ("-std=c++17", *COMMON, "-Wno-psabi"),
}
"""Compiler flags of each language.

In scalar C, only loops over arrays are vectorised. This does not change any result, because no sum changes its order. A
loop that calls a function, such as tanh, is vectorised only if the function is inlined. By default, -O2 inlines such a
function only if it has a single call. C++ for lanes is compiled with the default options of vectorisation."""
GCC_FLAGS = {"c": (), "c++": ("-fschedule-insns", "-fsched-pressure")}
"""Additional flags of each language for gcc. With them, gcc orders the instructions before it allocates registers, as
clang always does. A campaign takes 7 to 14 % less time, and its results are bit-identical."""
LIBRARIES = {"c": ("-lm",), "c++": ("-lpthread", "-lm")}
OLDER_FLAGS = {"-std=c++17": "-std=c++1z"}
"""Name of a compiler flag -> name of the flag in older compilers."""
TIME_LIMIT = 300.0
"""Maximum duration of a compilation (s)."""
LINES, WIDTH = 20, 160
"""Maximum number of lines, and of characters per line, of the compiler's output in an error message."""


class BuildError(InputError):
    """Error: a working compiler failed to build a library. The message contains the first lines of the compiler's
    output."""


class _BuildJob(NamedTuple):
    """Text to build, with compiler and flags."""

    compiler: Compiler
    language: str
    source: str
    extra: tuple[str, ...]

    @property
    def flags(self) -> tuple[str, ...]:
        """Return the usual flags for this compiler and language."""
        return compiler_flags(self.language, self.compiler.kind)

    @property
    def key(self) -> str:
        """Return the cache key of the library: a hash of text, flags, compiler, CPU and GENERATION."""
        given = (GENERATION, self.language, *self.flags, *LIBRARIES[self.language], *self.extra)
        return sha256("\0".join((*given, self.compiler.identity, cpu_identity(), self.source)).encode()).hexdigest()

    @property
    def part(self) -> str:
        """Return the subject of an error message: path and identity of the compiler."""
        return f"compiler {self.compiler.path} ({self.compiler.identity})"


def compiler_flags(language: str, kind: str) -> tuple[str, ...]:
    """Return the flags for a language (``c`` or ``c++``) and a kind of compiler (``gcc`` or ``clang``)."""
    return (*FLAGS[language], *(GCC_FLAGS[language] if kind == "gcc" else ()))


def build_library(source: str, language: str = "c", *, extra: tuple[str, ...] = ()) -> Path:
    """Return the path of the shared library of a C99 (``c``) or C++17 (``c++``) text. A library built before is cached.

    Args:
        source: the whole text. Files that it includes are not part of the cache key; include only system headers.
        language: ``c`` or ``c++``.
        extra: further flags and libraries, which come last on the command line.

    Raises NoCompilerError if no compiler works, and BuildError if the compiler fails or no folder can be written.
    """
    found = search_compiler(language)
    if found.compiler is None:
        raise NoCompilerError("compiled flight", found.problem, fix=found.fix)
    job = _BuildJob(found.compiler, language, source, extra)
    if library := find_library(job.key):
        return library
    try:
        return try_folders(functools.partial(_build_in_folder, job))
    except OSError as reason:
        raise BuildError(
            "cache of compiled programs",
            f"the library cannot be written to any folder: {reason}",
            fix=MAKE_ROOM_FIX,
        ) from reason


def load_library(path: Path) -> "ctypes.CDLL":
    """Load a shared library built by `build_library`."""
    import ctypes

    try:
        return ctypes.CDLL(os.fspath(path))
    except OSError as reason:
        raise BuildError(
            f"library {path}",
            f"it cannot be loaded: {reason}",
            fix="remove this file and run again, so that it is rebuilt",
        ) from reason


def _build_in_folder(job: _BuildJob, folder: Path) -> Path:
    with lock_key(folder, job.key):
        if library := find_in_folder(folder, job.key):  # another process built it meanwhile
            return library
        with work_folder(folder) as work:
            flags = _compile_source(job, work)
            about = {"compiler": job.compiler.identity, "flags": " ".join((*flags, *job.extra))}
            return store_library(folder, job.key, work / "program.so", about)


def _compile_source(job: _BuildJob, work: Path) -> tuple[str, ...]:
    """Compile the text to program.so in the work folder, and return the flags that were used."""
    (work / f"program.{SUFFIX[job.language]}").write_text(job.source, encoding="utf-8")
    first = _try_flags(job, job.flags, work)
    if first.status == 0:
        return job.flags
    accepted = _find_accepted_flags(job, work)
    # With an assembler older than the CPU, -march=native is accepted, but the instructions are not.
    tries = [accepted, tuple(flag for flag in accepted if flag != "-march=native")]
    for flags in dict.fromkeys(tries):
        if flags != job.flags and _try_flags(job, flags, work).status == 0:
            return flags
    said = "\n".join(f"    {line[:WIDTH]}" for line in first.text.strip().splitlines()[:LINES]) or "    nothing"
    raise BuildError(
        job.part,
        f"the compiler rejected the {job.language.upper()} text with status {first.status}:\n{said}",
        fix=f"try {NEEDED_VERSIONS}, named in CC or CXX; if that fails too, report this as a fault of trimtab.",
    )


def _try_flags(job: _BuildJob, flags: tuple[str, ...], work: Path, name: str = "program") -> CompilerOutcome:
    """Run the compiler with these flags and return the outcome. The library NAME.so exists if the status is 0."""
    library = work / f"{name}.so"
    library.unlink(missing_ok=True)
    arguments = (*flags, "-shared", "-fPIC", "-o", library.name, f"{name}.{SUFFIX[job.language]}")
    command = (job.compiler.path, *job.compiler.options, *arguments, *job.extra, *LIBRARIES[job.language])
    outcome = run_compiler(command, work, TIME_LIMIT)
    if outcome.interruption:
        fix = "run again; if the error occurs again, free some memory, or name another compiler in CC or CXX."
        raise BuildError(job.part, f"{outcome.interruption} before the library was built", fix=fix)
    if outcome.status == 0 and not _is_library(library):
        said = " ".join(outcome.text.split())[:300]
        problem = f"it reported success, but built no library{f', and said {said!r}' if said else ''}"
        raise BuildError(job.part, problem, fix="name another compiler in CC or CXX.")
    return outcome


def _is_library(path: Path) -> bool:
    """Return True if a file begins like an ELF or Mach-O library. A 64-bit ELF file must have the length stated in its
    header."""
    try:
        content = path.read_bytes()
    except OSError:
        return False
    if content[:6] == b"\x7fELF\x02\x01":  # the table of sections is at the end of the file
        start, size, count = (int.from_bytes(content[i:j], "little") for i, j in ((40, 48), (58, 60), (60, 62)))
        return len(content) >= max(64, start + size * count)
    return content[:4] in (b"\x7fELF", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe")


def _find_accepted_flags(job: _BuildJob, work: Path) -> tuple[str, ...]:
    """Return the flags that the compiler accepts. Raise BuildError if it rejects a flag that affects results."""
    (work / f"flags.{SUFFIX[job.language]}").write_text("int nothing;\n")

    def takes(*flags: str) -> bool:
        return _try_flags(job._replace(extra=()), flags, work, "flags").status == 0

    wanted = job.flags
    if takes(*wanted) or not takes():
        return wanted
    taken = []
    for flag in wanted:
        if takes(flag):
            taken.append(flag)
        elif flag in OLDER_FLAGS and takes(OLDER_FLAGS[flag]):
            taken.append(OLDER_FLAGS[flag])
        elif flag in REQUIRED[job.language] or flag in OLDER_FLAGS:
            raise BuildError(
                job.part,
                f"the compiler is too old: it rejects {flag}",
                fix=f"install {NEEDED_VERSIONS}, and name it in CC or CXX if another is found first.",
            )
    return tuple(taken)
