"""The image on the board that QEMU emulates, its UART behind a TCP port of this machine."""

import contextlib
import socket
import subprocess
import time

MACHINES = {"cortex-m4": "mps2-an386", "cortex-m7": "mps2-an500"}


@contextlib.contextmanager
def emulator(elf, folder, *more, machine="mps2-an500"):
    """The port at which it listens; the emulator ends with the block. What the board remembers lies in the folder."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    uart = f"socket,id=uart,host=127.0.0.1,port={port},server=on,wait=off,nodelay=on"
    command = ["qemu-system-arm", "-M", machine, "-kernel", str(elf), "-nodefaults", "-nic", "none", "-no-reboot"]
    command += ["-display", "none", "-monitor", "none", "-chardev", uart, "-serial", "chardev:uart"]
    command += ["-semihosting-config", "enable=on,target=native", *more]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, cwd=folder, stdin=quiet, stdout=quiet, stderr=subprocess.PIPE, text=True) as qemu:
        try:
            for _ in range(100):
                with contextlib.suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port)):
                    break
                assert qemu.poll() is None, qemu.stderr.read()
                time.sleep(0.1)
            yield port
            assert qemu.poll() is None, qemu.stderr.read()
        finally:
            qemu.kill()
