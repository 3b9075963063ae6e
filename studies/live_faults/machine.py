"""Faults of the machine on which a process runs: its disk and its wall clock."""

import contextlib
import os
import shutil
import subprocess
from pathlib import Path

DISK = 160_000_000
"""Size of the small disk (bytes). A vehicle is armed with at least 100 MB for its log."""
CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long stepped(void)
{
    const char *step = getenv("STEP_S"), *when = getenv("STEP_WHEN");
    return step && when && access(when, F_OK) == 0 ? atol(step) : 0;
}

int clock_gettime(clockid_t which, struct timespec *now)
{
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int status = real(which, now);
    if (which == CLOCK_REALTIME || which == CLOCK_REALTIME_COARSE) now->tv_sec += stepped();
    return status;
}

int gettimeofday(struct timeval *now, void *zone)
{
    struct timespec t;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &t);
    now->tv_sec = t.tv_sec;
    now->tv_usec = t.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *where)
{
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    if (where) *where = t.tv_sec;
    return t.tv_sec;
}
"""


def explain_no_compiler() -> str:
    """Return the reason why a process's wall clock cannot be stepped on this machine, or an empty text."""
    return "" if shutil.which("cc") else "no C compiler to build a wall clock"


def build_clock(folder: Path, seconds: int) -> dict[str, str]:
    """Return the environment of a process whose wall clock jumps when the file `stepped` is in the folder.

    It preloads a library whose clock functions replace those of the C library.
    """
    source, library = folder / "clock.c", folder / "clock.so"
    source.write_text(CLOCK, "ascii")
    subprocess.run(["cc", "-O1", "-fPIC", "-shared", "-o", library, source, "-ldl"], check=True)
    return {"LD_PRELOAD": str(library), "STEP_S": str(seconds), "STEP_WHEN": str(folder / "stepped")}


def explain_no_mount() -> str:
    """Return the reason why no small disk can be mounted on this machine, or an empty text."""
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        return "only root may mount a small disk"
    return "" if shutil.which("mount") else "mount not found"


def mount_small_disk(where: Path) -> None:
    """Mount a small disk at a new folder."""
    where.mkdir()
    try:
        subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "trimtab", where], check=True, capture_output=True
        )
    except subprocess.CalledProcessError as error:
        raise OSError(f"mount: {error.stderr.decode().strip()}") from None


def unmount(where: Path) -> None:
    """Unmount a small disk."""
    subprocess.run(["umount", "-l", where], check=False, capture_output=True)


def fill_disk(ballast: Path) -> None:
    """Fill a small disk completely with one file."""
    with ballast.open("wb", 0) as file:
        for size in (1_000_000, 4096):
            with contextlib.suppress(OSError):
                while True:
                    file.write(bytes(size))
