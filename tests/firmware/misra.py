"""Check the firmware of an STM32F405 with cppcheck's MISRA C:2012 addon, and write the page of deviations.

    python tests/firmware/misra.py         write docs/export/misra.md
    python tests/firmware/misra.py check   list rules without a reason, and reasons without a violation

The addon reports rules by number only. The titles and the reasons are not quoted from the standard.
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
"""Files of each program, by part. Programs are checked one by one, as two programs may use the same name."""
DEFINES = ["HSE_HZ=8000000", "BAUD=921600", "BOX_SIZE=0x20000", "APB1_TIMER_HZ=84000000", "KEY_ADDRESS=0x08004000"]

DEVIATIONS = {
    "2.3": (
        "unused type names",
        "The header of a block declares all its structures. Some files that include the header need only one of them.",
    ),
    "2.4": (
        "unused enumerations",
        "Two programs share a header, and each program uses only a part of the header.",
    ),
    "2.5": (
        "unused macros",
        "The generated prologue is the same for all blocks. The period of a sensor is defined for human readers only.",
    ),
    "5.7": (
        "a tag used twice",
        "False alarm: the addon treats nested structures without tags as tags of the same name.",
    ),
    "5.8": (
        "an external name used again",
        "`run`, `fault` and `started` are functions of the start-up code, and also members of generated structures.",
    ),
    "5.9": (
        "an internal name used again",
        "Several files use the same short static names. No C file includes another, so the names cannot conflict.",
    ),
    "8.4": (
        "a definition without a declaration before it",
        "The function is called only from assembly, so a caller in C with a different declaration cannot exist.",
    ),
    "8.7": (
        "an external function used in one file only",
        "The functions of the board are one interface and are declared together, regardless of their callers.",
    ),
    "8.9": (
        "an object defined outside the only function that uses it",
        "Tables and the state of a driver are at the top of their file.",
    ),
    "8.11": (
        "an external array without its size",
        "The arrays are symbols of the linker. Only their address is used.",
    ),
    "9.3": (
        "an array with a partial initialiser",
        "C sets the remaining elements to zero. An SPI exchange sends these zeros while it reads.",
    ),
    "10.1": (
        "an operand of an inappropriate type",
        "Enumerators and constants of type int are used in shifts and masks. None of them is negative.",
    ),
    "10.3": (
        "a value assigned to another type",
        "The limits 1 and -1 of a duty are written as integers. Both numbers are exact as doubles.",
    ),
    "10.4": (
        "operands of two types",
        "Enumerators of type int are combined with unsigned numbers. None is negative, so no value changes.",
    ),
    "10.8": (
        "a composite expression cast to another type",
        "Differences, counts and masks are cast once, where they are used.",
    ),
    "11.4": (
        "a conversion between an integer and a pointer",
        "Registers and flash have fixed addresses, which C can only write as integers.",
    ),
    "12.1": (
        "operator precedence without brackets",
        "The precedence of arithmetic, comparison and logic is well known. gcc's -Wparentheses finds the risky cases.",
    ),
    "12.2": (
        "a shift by more bits than the type has",
        "False alarm: the addon assumes that a constant has 8 bits. All shifts move 32-bit numbers by less than 32.",
    ),
    "12.3": (
        "the comma operator",
        "False alarm: the addon treats commas in declarations and in lists of enumerators as the operator.",
    ),
    "13.3": (
        "an increment within an expression",
        "`a[n++] = x` has one side effect on one object.",
    ),
    "13.4": (
        "use of the value of an assignment",
        "Chains such as `a = b = c`, in which all operands have the same type, and `while ((n = f()) > 0)`.",
    ),
    "14.2": (
        "an unusual for loop",
        "The first or the last clause is a call or uses another variable. Each loop ends at a bound of one variable.",
    ),
    "14.4": (
        "a condition that is not Boolean",
        "The conditions are bits tested with `&`, or counts. Every value except zero counts as true.",
    ),
    "15.5": (
        "more than one return",
        "Functions return early on invalid input. One return would need flags and nesting. Nothing has to be released.",
    ),
    "15.6": (
        "a body without braces",
        "The body is one statement on the same line. gcc's -Wmisleading-indentation is an error here.",
    ),
    "15.7": (
        "else if without else",
        "The remaining cases need no action.",
    ),
    "17.7": (
        "an unused result",
        "The functions are memcpy, memmove and memset, which return their first argument.",
    ),
    "17.8": (
        "a function parameter that is changed",
        "The parameter is used as a counter or is shifted. The variable of the caller does not change.",
    ),
    "18.4": (
        "pointer arithmetic",
        "The pointer points into a buffer whose bound is checked in the same function.",
    ),
    "20.10": (
        "# or ## in a macro",
        "One macro, SEND, builds the names of MAVLink's generated functions.",
    ),
}
"""Rule -> its title, and the reason for accepting the deviation."""


HEAD = """# MISRA C:2012

This page lists the violations of MISRA C:2012 that cppcheck's MISRA addon reports in the firmware of an
[STM32F405](stm32f405.md). For each violated rule, the page gives the reason for accepting the deviation. The page is
for users who assess the firmware. Read [STM32F405](stm32f405.md) first. `python tests/firmware/misra.py` writes this
page. A test fails if the firmware violates a rule for which this page gives no reason.

The addon checks only those rules that can be decided from the text of the program. MAVLink's generated headers are not
checked. This page is not a certificate: MISRA compliance requires more than the report of a tool.

| rule | violation | number in hand-written C | number in generated C | reason for accepting the violation |
|---|---|---|---|---|"""


def run_cppcheck(folder, names):
    """Return (rule, file, line) of each violation that the addon reports in files of a folder."""
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
    """Return the violations of each part."""
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
    """Return the page: number of violations of each rule, and the reason for accepting them."""
    counts = {part: Counter(rule for rule, _, _ in rows) for part, rows in violations.items()}
    rules = sorted(set().union(*counts.values()), key=by_number)
    lines = [HEAD]
    for rule in rules:
        title, reason = DEVIATIONS[rule]
        hand, made = (counts[part][rule] for part in PARTS)
        lines.append(f"| {rule} | {title} | {hand} | {made} | {reason} |")
    totals = [sum(counts[part].values()) for part in PARTS]
    lines += [
        "",
        f"Total: {totals[0]} violations in hand-written C, {totals[1]} in generated C with its headers.",
        "",
        "Source: MISRA C:2012, by rule number. The titles and the reasons are not quoted from the standard.",
        "",
    ]
    return "\n".join(lines)


def find_unreasoned(violations):
    """Return the violated rules without a reason."""
    return sorted({rule for rows in violations.values() for rule, _, _ in rows} - set(DEVIATIONS), key=by_number)


def main():
    violations = find_violations()
    for rule in find_unreasoned(violations):
        where = [f"{file}:{line}" for rows in violations.values() for r, file, line in rows if r == rule]
        print(f"rule {rule} is violated and has no reason: {', '.join(where)}")
    if sys.argv[1:] == ["check"]:
        unused = set(DEVIATIONS) - {rule for rows in violations.values() for rule, _, _ in rows}
        print("reasons without a violation:", *sorted(unused, key=by_number))
    elif not find_unreasoned(violations):
        PAGE.write_text(page_text(violations), "utf-8")


if __name__ == "__main__":
    main()
