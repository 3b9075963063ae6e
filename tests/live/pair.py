"""A vehicle and an autopilot as two programs, started as a user would start them."""

import json
import os
import subprocess
import sys
from pathlib import Path

BUILD_S = 200
"""Seconds in which a program is compiled and has flown: only a failure takes this long."""


def program(*arguments, folder):
    """`trimtab …` as a process of its own, with keys in a folder."""
    command = [sys.executable, "-c", "import sys; from trimtab.cli import main; sys.exit(main())", *arguments]
    environment = {**os.environ, "TRIMTAB_CONFIG": str(folder / "config")}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finished(process):
    """Exit status, what it printed as JSON, and what it said to people."""
    try:
        out, said = process.communicate(timeout=BUILD_S)
    except subprocess.TimeoutExpired:
        process.kill()
        out, said = process.communicate()
        raise AssertionError(f"did not end: {out} {said}") from None
    lines = out.strip().splitlines()
    return process.returncode, json.loads(lines[-1]) if lines and lines[-1].startswith("{") else None, said


def make_key(folder, vehicle="hovercraft"):
    from trimtab.wire.signing import create_key

    create_key(Path(folder) / "config" / "keys" / f"{vehicle}.key")


def fly_pair(folder, scenario, listen, link, *both, vehicle=(), pilot=()):
    """Both ends to their end; what each gives (status, result, said)."""
    if "--unsigned" not in both:
        make_key(folder, scenario.partition("/")[0])
    ends = (("vehicle", "--listen", listen, "there", vehicle), ("fly", "--link", link, "here", pilot))
    there, here = (
        program(verb, scenario, option, uri, "--out", str(folder / out), "--json", *both, *own, folder=folder)
        for verb, option, uri, out, own in ends
    )
    return finished(there), finished(here)
