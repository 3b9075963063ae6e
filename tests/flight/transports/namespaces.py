"""Two hosts in separate network namespaces, joined by a virtual cable. They end with their processes."""

import os
import shutil
import subprocess

NEAR, FAR = "10.98.0.1", "10.98.0.2"


def why_not():
    """Reason why this machine cannot create namespaces, or an empty text."""
    missing = [name for name in ("unshare", "nsenter", "ip") if shutil.which(name) is None]
    if missing:
        return f"network namespaces need {', '.join(missing)}"
    tried = subprocess.run(
        [*_unshare(), "ip", "link", "add", "va", "type", "veth", "peer", "name", "vb"],
        capture_output=True,
        text=True,
    )
    return f"this machine makes no network namespaces: {tried.stderr.strip()}" if tried.returncode else ""


def _unshare():
    """Command prefix for a new namespace. Root keeps its real-time scheduling; others also need a user namespace."""
    return ["unshare", "-n" if os.geteuid() == 0 else "-rn"]


class Hosts:
    """`near` with the address NEAR and `far` with FAR. Without root, user namespaces are required."""

    def __init__(self):
        self._holders = [self._hold(_unshare())]
        self._holders.append(self._hold([*self.inside(0), "unshare", "-n"]))
        self.run(0, "ip", "link", "add", "va", "type", "veth", "peer", "name", "vb", "netns", str(self._pid(1)))
        for host, (cable, place) in enumerate((("va", NEAR), ("vb", FAR))):
            self.run(host, "ip", "addr", "add", f"{place}/24", "dev", cable)
            for name in ("lo", cable):
                self.run(host, "ip", "link", "set", name, "up")
        self._started = []

    def _hold(self, before):
        """Start a process that keeps the namespace made by `before` alive. Wait for its first line."""
        holder = subprocess.Popen([*before, "sh", "-c", "echo $$; exec sleep 600"], stdout=subprocess.PIPE, text=True)
        assert holder.stdout.readline()
        return holder

    def _pid(self, host):
        return self._holders[host].pid

    def inside(self, host):
        """Command prefix that runs a command on host 0 (near) or 1 (far)."""
        user = [] if os.geteuid() == 0 else ["--preserve-credentials", "-U"]
        return ["nsenter", *user, "-n", "-t", str(self._pid(host))]

    def run(self, host, *words):
        """Run a program to its end on host 0 (near) or 1 (far). Return its output."""
        done = subprocess.run([*self.inside(host), *words], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def start(self, host, *words):
        """Start a program on a host, and wait for its first line."""
        started = subprocess.Popen([*self.inside(host), *words], stdout=subprocess.PIPE, text=True)
        self._started.append(started)
        assert started.stdout.readline(), "it ended without a word"
        return started

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in (*self._started, *reversed(self._holders)):
            process.terminate()
        for process in (*self._started, *self._holders):
            process.wait(10)
            process.stdout.close()
