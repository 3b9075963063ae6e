"""The image on the board that QEMU emulates, its UART behind a TCP port of this machine."""

import contextlib
import re
import socket
import subprocess
import time

MACHINES = {
    "cortex-m4": ("mps2-an386", "0x3FF000"),
    "cortex-m7": ("mps2-an500", "0x3FF000"),
    "stm32f405": ("netduinoplus2", "0x08004000"),
}
"""Of each board: QEMU's machine, and where the key goes."""


@contextlib.contextmanager
def emulator(elf, folder, *more, board="cortex-m7"):
    """The port at which it listens; the emulator ends with the block. What the board remembers lies in the folder."""
    machine, key_address = MACHINES[board]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    uart = f"socket,id=uart,host=127.0.0.1,port={port},server=on,wait=off,nodelay=on"
    command = ["qemu-system-arm", "-M", machine, "-kernel", str(elf), "-nodefaults", "-nic", "none"]
    command += ["-device", f"loader,file={elf.parent / 'key.bin'},addr={key_address},force-raw=on"]
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


def find_symbol(elf, name):
    """Its address."""
    table = subprocess.run(["arm-none-eabi-nm", str(elf)], capture_output=True, text=True, check=True).stdout
    (address,) = [int(line.split()[0], 16) for line in table.splitlines() if line.split()[-1] == name]
    return address


class Debugger:
    """The emulator's debugging port. The processor stands still as long as this is open."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=5)
        self.received = b""

    def ask(self, text):
        """The answer; that the processor stopped is said unasked, and passed over."""
        checksum = sum(text.encode()) % 256
        self.socket.sendall(f"${text}#{checksum:02x}".encode())
        while True:
            packet = re.match(rb"[^$]*\$([^#]*)#..", self.received, re.DOTALL)
            if packet is None:
                self.received += self.socket.recv(4096)
                continue
            self.received = self.received[packet.end() :]
            self.socket.sendall(b"+")
            if not packet[1].startswith(b"T"):
                return packet[1].decode()

    def read(self, address, n):
        answer = self.ask(f"m{address:x},{n:x}")
        assert len(answer) == 2 * n, answer
        return bytes.fromhex(answer)

    def write(self, address, data):
        assert self.ask(f"M{address:x},{len(data):x}:{data.hex()}") == "OK"

    def close(self):
        self.ask("D")  # and it goes on
        self.socket.close()
