"""Names of functions, arguments and members in generated C: valid in C and C++, and no two of them the same."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export.conftest import require

import trimtab
from trimtab.compiler import identifiers
from trimtab.compiler.compiled_function import export_callable
from trimtab.compiler.identifiers import function_identifier, identifier
from trimtab.core.errors import InputError
from trimtab.export.verify import verify_folder

HEADERS = """assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg
stdbool stddef stdint stdio stdlib stdnoreturn string tgmath time wchar wctype unistd fcntl pthread strings sys/stat
sys/socket sys/time termios"""
CPP_HEADERS = "algorithm array bit cmath complex cstdio iostream numeric string thread vector"
OTHERS = """B0 NULL EOF NAN INFINITY I M_PI INT32_MAX SIZE_MAX LANES EACH_LANE TT_FMA _Bool _Complex __attribute__ __x
int8_t int32_t uint64_t size_t double_t float_t div_t timer_t vf64 vi64 tt_sin tv_any ttv_ma v1 a2 x3 table1 default0
__builtin_sqrt _Exit in out f s p i j l given runs state random_r isalpha_l clock_gettime pthread_create time_t"""
WORDS = sorted({*identifiers.RESERVED, *identifiers.RESERVED_FUNCTIONS, *OTHERS.split()})
ODD = {"a b": "a_b", "": "_", "2nd": "_2nd", "x\u00b2": "x2", "\u03b8": "theta", "\u0394t": "Deltat", "*/": "___"}
ODD |= {
    "\u00e9t\u00e9": "ete",
    "\u6570": "_",
    "rate": "rate",
    "KP": "KP",
    "KPI": "KPI_",
    "PI": "PI_",
    "B0": "B0_",
    "FX": "FX",
    "K": "K",
    "kp": "kp",
    "lambda": "lambda_",
}


@pytest.mark.parametrize("name", ODD)
def test_names_become_ascii(name: str) -> None:
    assert identifier(name) == ODD[name]


def compile_text(compiler: str, text: str, *options: str) -> None:
    require(lambda: [] if shutil.which(compiler) else [compiler.replace("clang++", "clang")])
    command = [compiler, *options, "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]


def declarations(language: str) -> str:
    names = HEADERS.replace("tgmath", "").split() if language == "c++" else HEADERS.split()
    lines = [f"#include <{name}.h>" for name in names if language == "c" or name not in ("complex", "stdnoreturn")]
    lines += [f"#include <{name}>" for name in CPP_HEADERS.split()] if language == "c++" else []
    members = [f"double {identifier(word)};" for word in WORDS]
    functions = [f"void {function_identifier(word)}(const arguments_of *in);" for word in WORDS]
    around = ('extern "C" {', "}") if language == "c++" else ("", "")
    return "\n".join([*lines, "typedef struct {", *members, "} arguments_of;", around[0], *functions, around[1], ""])


BUILDS = [("gcc", "c", "-std=gnu11"), ("gcc", "c", "-std=c99"), ("clang", "c", "-std=gnu11")]
BUILDS += [("g++", "c++", "-std=c++20"), ("clang++", "c++", "-std=c++17")]


@pytest.mark.thorough("g++-c++--std=c++20")
@pytest.mark.parametrize(("compiler", "language", "standard"), BUILDS)
def test_reserved_words_are_avoided(compiler: str, language: str, standard: str) -> None:
    compile_text(compiler, declarations(language), "-x", language, standard, "-D_GNU_SOURCE")


@pytest.mark.thorough
def test_colliding_names_stay_distinct(tmp_path: Path) -> None:
    def f(x: Any, argument1: Any, *rest: Any) -> Any:
        first = x["a b"] + 10 * x["a_b"] + 100 * x["a_b_2"] + 1000 * x["a"]["b"] + 1e4 * x["a "]["b"]
        return {"x\u00b2": first, "x2": 1e5 * argument1 + 1e6 * rest[0], "*/": x["/*"], "": x["/*"]}

    inside = {"b": 4.0}
    names = {"a b": 1.0, "a_b": 2.0, "a_b_2": 3.0, "a": inside, "a ": {"b": 5.0}, "/*": 6.0}
    trimtab.compile(f, names, 7.0, 8.0).export(tmp_path, name="apart")
    assert verify_folder(tmp_path).good


NAMES = ("template", "export", "_Bool", "double_t", "tt_sin", "exp10", "NAN", "linux", "main", "read")


@pytest.mark.parametrize("name", NAMES)
def test_functions_of_any_name_compile(name: str) -> None:
    def f(x: Any) -> Any:
        return x * 2 + 1

    f.__name__ = name
    compiled = trimtab.compile(f, 1.5)
    assert compiled.name == name
    assert compiled(2.0) == 5.0


@pytest.mark.thorough("tt_sin", "vf64")
@pytest.mark.parametrize("name", ["template", "tt_sin", "vf64"])
def test_functions_of_any_name_compile_over_lanes(name: str) -> None:
    def f(x: Any) -> Any:
        return x * 2 + 1

    f.__name__ = name
    assert np.array_equal(trimtab.compile(f, 1.5, lanes=4).lanes(np.arange(9.0)), np.arange(9.0) * 2 + 1)


@pytest.mark.thorough("line", "in", "vectors", "export", "read")
@pytest.mark.parametrize("name", ["line", "in", "workspace", "vectors", "export", "read"])
def test_exported_functions_of_any_name_pass_verify(name: str, tmp_path: Path) -> None:
    def f(new: Any, NAN: Any) -> Any:
        return {"class": new * 2 + NAN}

    f.__name__ = name
    exported = export_callable(f, (1.5, 2.5), tmp_path)
    assert exported.block.name == function_identifier(name) != name
    assert verify_folder(tmp_path).good


def test_verify_rejects_header_invalid_in_cpp(tmp_path: Path) -> None:
    export_callable(lambda x: x + 1, (1.5,), tmp_path, name="plain")
    header = tmp_path / "plain.h"
    header.write_text(header.read_text().replace("double x;", "double x; double class;"))
    with pytest.raises(InputError, match=r"C\+\+ compiler rejected plain\.h"):
        verify_folder(tmp_path)
