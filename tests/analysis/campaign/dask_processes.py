"""Certificates, schedulers and workers for tests: as the how-to page has them, word for word where it can be."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "campaign-on-several-machines.md"
HOSTS = ("head", "one", "two", "desk")
DASK = (sys.executable, "-m", "dask")


def commands(marker):
    """Commands of the page's block that begins with a comment."""
    blocks = re.findall(r"```console\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    block = next(b for b in blocks if marker in b)
    return [line[2:] for line in block.replace("\\\n", "").splitlines() if line.startswith("$ ")]


def certificates(folder):
    """An authority, and a certificate for each host, made by the page's commands."""
    first, second = commands("ca.key"), commands("HOST.key")
    for line in [*first, *(line.replace("HOST", host) for host in HOSTS for line in second)]:
        subprocess.run(line, shell=True, cwd=folder, check=True, capture_output=True)


def flags(folder, host):
    """Of dask's programs."""
    pem = [f"{folder}/ca.pem", f"{folder}/{host}.pem", f"{folder}/{host}.key"]
    return [w for pair in zip(("--tls-ca-file", "--tls-cert", "--tls-key"), pem, strict=True) for w in pair]


def files(folder, host="desk"):
    """Of `cluster`."""
    return {"ca": folder / "ca.pem", "cert": folder / f"{host}.pem", "key": folder / f"{host}.key"}


def environment():
    """Variables with which other processes find what this one finds."""
    paths = [str(Path(__file__).parents[2]), *filter(None, sys.path)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


class Processes:
    """What was started, gone in the end."""

    def __init__(self, folder, before=lambda host: []):
        self.folder, self._before, self._started = folder, before, []

    def start(self, host, *words):
        """Start one of dask's programs on a host; its words go to a file."""
        log = self.folder / f"{len(self._started)}-{words[0]}.log"
        with log.open("w") as out:
            full = [*self._before(host), *DASK, *words, *flags(self.folder, host)]
            made = subprocess.Popen(full, stdout=out, stderr=out, cwd=self.folder, env=environment())
        self._started.append(made)
        made.log = log
        return made

    def scheduler(self, address="127.0.0.1", port=0):
        """A scheduler, once it listens, with its address."""
        quiet = ("--no-dashboard", "--dashboard-address", "127.0.0.1:0")
        made = self.start("head", "scheduler", "--protocol", "tls", "--host", address, "--port", str(port), *quiet)
        return made, said(made, r"Scheduler at:\s+(tls://\S+)")

    def worker(self, host, uri, *more):
        """A worker of one process, once the scheduler knows it."""
        quiet = ("--no-dashboard", "--dashboard-address", "127.0.0.1:0", "--nworkers", "1", "--nthreads", "1")
        made = self.start(host, "worker", uri, *quiet, "--no-nanny", *more)
        said(made, r"(Registered to:)")
        return made

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in reversed(self._started):
            process.kill()
            process.wait(10)


def said(process, pattern, patience=60.0):
    """What a process has written, once it has."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        found = re.search(pattern, process.log.read_text())
        if found:
            return found[1]
        assert process.poll() is None, process.log.read_text()
        time.sleep(0.05)
    raise AssertionError(process.log.read_text())
