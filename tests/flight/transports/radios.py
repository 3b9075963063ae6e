"""Two Bluetooth radios in software, in one process: RFCOMM, L2CAP and HCI of a full stack over virtual controllers.

Each connection is a descriptor, as with the system's sockets, so that the tests use the code of real flights.
"""

import asyncio
import contextlib
import socket
import threading

from bumble import rfcomm
from bumble.core import PhysicalTransport
from bumble.testing.test_utils import TwoDevices

VEHICLE, GROUND = "F0:F0:F0:F0:F0:F0", "F1:F1:F1:F1:F1:F1"


class Radios:
    """The vehicle's radio listens on a channel, and the ground's radio dials it."""

    def __init__(self):
        self._loop, self._answered, self._servers = asyncio.new_event_loop(), [], []
        self._tasks, self._connection = set(), None
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._wait(self._power_on())

    def stack(self, address, channel, listen):
        """Argument `stack` of open_rfcomm()."""
        if listen:
            self._wait(self._listen(channel))
        return _Dialer(self, address, channel, listen)

    def lose(self):
        """Break the connection of the radios, as if out of range."""

        self._wait(self._part())

    async def _part(self):
        connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(Exception):
                await asyncio.wait_for(connection.disconnect(), 5.0)

    def _wait(self, work):
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(20.0)

    async def _power_on(self):
        self._devices = TwoDevices()
        for device in self._devices.devices:
            device.classic_enabled = True
            device.le_enabled = False
            await device.power_on()
        self._server = rfcomm.Server(self._devices[0])

    async def _listen(self, channel):
        self._server.listen(lambda dlc: self._answered.append(self._bridge(dlc)), channel)

    async def _dial(self, address, channel):
        await self._part()
        self._connection = connection = await self._devices[1].connect(address, transport=PhysicalTransport.BR_EDR)
        multiplexer = await rfcomm.Client(connection).start()
        return self._bridge(await multiplexer.open_dlc(channel), connection)

    def _bridge(self, dlc, connection=None):
        """Return a descriptor whose bytes go over the channel. Closing either end closes the other."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        theirs.setblocking(False)
        coming = asyncio.Queue()
        dlc.sink = coming.put_nowait
        dlc.on(dlc.EVENT_CLOSE, lambda: coming.put_nowait(b""))

        async def up():
            with contextlib.suppress(OSError):
                while data := await self._loop.sock_recv(ours, 4096):
                    dlc.write(data)
                    await dlc.drain()
            coming.put_nowait(b"")
            if connection is not None and connection is self._connection:
                await self._part()

        async def down():
            with contextlib.suppress(OSError):
                while data := await coming.get():
                    await self._loop.sock_sendall(ours, data)
                ours.shutdown(socket.SHUT_RDWR)

        async def both():
            with ours:
                await asyncio.gather(up(), down())

        task = self._loop.create_task(both())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return theirs.detach()

    def close(self):
        self.lose()

        async def end():
            for task in list(self._tasks):
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)

        self._wait(end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        self._loop.close()


class _Dialer:
    def __init__(self, radios, address, channel, listen):
        self._radios, self._place, self._listen, self._future = radios, (address, channel), listen, None

    def dial(self):
        if self._listen:
            return self._radios._answered.pop(0) if self._radios._answered else -1
        if self._future is None:
            self._future = asyncio.run_coroutine_threadsafe(self._radios._dial(*self._place), self._radios._loop)
        if not self._future.done():
            return -1
        future, self._future = self._future, None
        try:
            return future.result()
        except Exception as error:
            raise OSError(str(error)) from error

    def wait_event(self):
        return -1, 0

    def exchange(self, fd):
        return -1

    def close(self):
        pass
