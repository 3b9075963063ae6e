"""MISRA C:2012 by cppcheck's addon on what flies on an STM32F405, and the page with each deviation's reason.

    python tests/firmware/misra.py         write docs/export/misra.md anew
    python tests/firmware/misra.py check   say what is not argued, or argued and gone

The addon knows the rules by number only; the words here are this project's own.
"""

import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from firmware.host import KEY

from trimtab.flight.boards.firmware_folder import write_firmware
from trimtab.scenarios.build import build

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "export" / "misra.md"
PARTS = {
    "hand-written": [
        ["main.c", "portable/*.c", "drive/*.c", "drivers/*.c", "boards/stm32f405/*.c"],
        ["slave/*.c", "boards/stm32f405/slave/*.c", "portable/p[iu]*.c"],
    ],
    "generated": [["exported/failsafe.c", "exported/speed_regulator.c", "exported/command.c", "emulated/samples.c"]],
}
"""Of each part the programs, for a name may be another's in another program."""
DEFINES = ["HSE_HZ=8000000", "BAUD=921600", "BOX_SIZE=0x20000", "APB1_TIMER_HZ=84000000", "KEY_ADDRESS=0x08004000"]

DEVIATIONS = {
    "2.3": (
        "type names that nothing uses",
        "A block's header declares its structures alike for all users; some need one of them only.",
    ),
    "2.4": (
        "enumerations of which nothing is used",
        "Two programs share a header, and each uses some of it.",
    ),
    "2.5": (
        "macros that nothing uses",
        "The generated prologue serves all blocks, and a sensor's period is for who measures it.",
    ),
    "5.7": (
        "a tag that is used twice",
        "Structures without tags within structures, which the addon takes for tags of one name.",
    ),
    "5.8": (
        "an external name used again",
        "`run`, `fault`, `started`: functions of the start, and members of generated structures.",
    ),
    "5.9": (
        "an internal name used again",
        "Short static names repeat between files and never meet: no file includes another's C.",
    ),
    "8.4": (
        "a definition without a declaration before it",
        "What only assembly calls has no caller in C that could disagree.",
    ),
    "8.7": (
        "an external function with one user",
        "The board's functions are one interface, declared together, whoever calls them.",
    ),
    "8.9": (
        "an object that one function uses stands outside it",
        "Tables and a driver's state stand together at the head of their file.",
    ),
    "8.11": (
        "an external array without its size",
        "The linker's symbols, of which only the address counts.",
    ),
    "9.3": (
        "an array begun, not filled, by its initialiser",
        "The rest is zero by the language: the bytes that an SPI exchange sends while it reads.",
    ),
    "10.1": (
        "an operand of an unwanted kind",
        "Enumerators and constants, of type int, in shifts and masks: none is negative.",
    ),
    "10.3": (
        "a value assigned to another kind",
        "A duty is clipped to 1 and -1, written as integers: exact as doubles.",
    ),
    "10.4": (
        "operands of two kinds",
        "Enumerators, of type int, beside unsigned numbers: none is negative, so no value changes.",
    ),
    "10.8": (
        "a composite expression cast to another kind",
        "Differences, counts and masks, cast once where they are used.",
    ),
    "11.4": (
        "integers and pointers converted",
        "Registers and flash have addresses; there is no other way to write them down.",
    ),
    "12.1": (
        "precedence left to the language",
        "Arithmetic, comparison, logic; gcc's -Wparentheses, an error here, covers what is treacherous.",
    ),
    "12.2": (
        "a shift by more than the type has",
        "The addon takes a constant for eight bits; shifts are below 32, of 32 bits.",
    ),
    "12.3": (
        "comma",
        "Several variables in one declaration, and lists of enumerators, which the addon takes for the operator.",
    ),
    "13.3": (
        "an increment within an expression",
        "`a[n++] = x`: one side effect on one object.",
    ),
    "13.4": (
        "the value of an assignment",
        "A value handed on along a chain of one kind, and `while ((n = f()) > 0)`.",
    ),
    "14.2": (
        "an unusual for loop",
        "Its step or its start is a call or another variable; each ends by a bound on one variable.",
    ),
    "14.4": (
        "a condition that is not Boolean",
        "Bits tested by `&`, and counts: what is not zero is true.",
    ),
    "15.5": (
        "more than one return",
        "Refusals return at once: fewer levels than flags would need, and nothing to release at an end.",
    ),
    "15.6": (
        "a body without braces",
        "One statement on one line; gcc's -Wmisleading-indentation is an error here.",
    ),
    "15.7": (
        "else if without else",
        "Nothing is to be done otherwise.",
    ),
    "17.7": (
        "a result not used",
        "memcpy, memmove and memset give back their first argument.",
    ),
    "17.8": (
        "a parameter changed",
        "A count that runs down, a word that is shifted out: the caller's is a copy.",
    ),
    "18.4": (
        "pointer arithmetic",
        "A place in a buffer whose bound is checked in the same function.",
    ),
    "20.10": (
        "# or ## in a macro",
        "One macro, SEND, makes the names of MAVLink's generated functions.",
    ),
}
"""Rule: what it is about, and why breaking it is let be."""


HEAD = """# MISRA C:2012

What cppcheck's MISRA addon says of the C that flies on an [STM32F405](stm32f405.md), and why each deviation is let be.
Written by `python tests/firmware/misra.py`; a test fails where a rule is broken that is not argued here.

The addon checks the rules that can be decided by looking at the text; MAVLink's generated headers it does not see. It
is no certificate: MISRA compliance asks for more than a tool's report.

| rule | is about | hand-written | generated | why it is let be |
|---|---|---|---|---|"""


def run_cppcheck(folder, names):
    """(rule, file, line) of what the addon says of files of a folder."""
    files = [str(p.relative_to(folder)) for name in names for p in sorted(folder.glob(name))]
    include = [
        f"-I{part}" for part in ("portable", "drive", "drivers", "slave", "boards/stm32f405", "exported", "emulated")
    ]
    command = ["cppcheck", "--addon=misra", "--std=c99", "--quiet", "--enable=style", "--template={id} {file} {line}"]
    command += ["--suppress=*:exported/world.h", *include, *(f"-D{d}" for d in DEFINES), *files]
    said = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stderr
    found = re.findall(r"^misra-c2012-([\d.]+) (\S+) (\d+)$", said, re.MULTILINE)
    return sorted({(rule, file, int(line)) for rule, file, line in found})


def find_violations():
    """Of each part, what the addon says."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_firmware(build("hovercraft/forward", {"navigation": "ins"}), folder, KEY, board="stm32f405")
        return {
            part: sorted({violation for names in programs for violation in run_cppcheck(folder, names)})
            for part, programs in PARTS.items()
        }


def by_number(rule):
    return [int(n) for n in rule.split(".")]


def page_text(violations):
    """The page: how often each rule is broken, where most, and why that is let be."""
    counts = {part: Counter(rule for rule, _, _ in rows) for part, rows in violations.items()}
    rules = sorted(set().union(*counts.values()), key=by_number)
    lines = [HEAD]
    for rule in rules:
        title, reason = DEVIATIONS[rule]
        hand, made = (counts[part][rule] or "" for part in PARTS)
        lines.append(f"| {rule} | {title} | {hand} | {made} | {reason} |")
    totals = [sum(counts[part].values()) for part in PARTS]
    lines += [
        "",
        f"In all {totals[0]} places of hand-written C, and {totals[1]} of generated C and the headers it draws in.",
        "",
        "Source: MISRA C:2012, by number; headings and reasons are this project's words.",
        "",
    ]
    return "\n".join(lines)


def unargued(violations):
    """Rules that are broken and not argued."""
    return sorted({rule for rows in violations.values() for rule, _, _ in rows} - set(DEVIATIONS), key=by_number)


def main():
    violations = find_violations()
    for rule in unargued(violations):
        where = [f"{file}:{line}" for rows in violations.values() for r, file, line in rows if r == rule]
        print(f"rule {rule} is not argued: {', '.join(where)}")
    if sys.argv[1:] == ["check"]:
        unused = set(DEVIATIONS) - {rule for rows in violations.values() for rule, _, _ in rows}
        print("argued and gone:", *sorted(unused, key=by_number))
    elif not unargued(violations):
        PAGE.write_text(page_text(violations), "utf-8")


if __name__ == "__main__":
    main()
