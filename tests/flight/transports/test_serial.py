import os
import pty

import pytest
from flight.transports.ends import EVERY_BYTE, deliver, meet
from flight.transports.relays import LEFT, SerialPair

from trimtab.core.errors import InputError
from trimtab.flight.transports.open_link import open_link


@pytest.fixture
def device():
    """Path of a pseudo-terminal that behaves like a serial device."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    yield path
    os.close(master)


def test_a_device_is_opened_by_one_program_at_a_time(device):
    first = open_link(f"serial://{device}")
    assert first.statistics.connected
    with pytest.raises(InputError, match=r"another program uses the device(.|\n)*Fix: .*fuser"):
        open_link(f"serial://{device}")
    first.close()
    again = open_link(f"serial://{device}")
    assert again.statistics.connected
    again.close()


@pytest.mark.real_time
def test_a_device_that_is_unplugged_is_opened_again(tmp_path):
    with SerialPair(tmp_path) as cable:
        a, b = (open_link(uri) for uri in cable.uris)
        meet(a, b)
        for life in (1, 2):
            cable.unplug(LEFT)
            while a.statistics.connected:
                a.receive(0.01)
            assert a.send(b"x") is False
            assert b.send(b"into nothing")
            assert a.receive(0.02) is None
            cable.plug(LEFT)
            meet(a, b)
            assert deliver(a, b, EVERY_BYTE) == EVERY_BYTE
            assert (a.statistics.reconnects, b.statistics.reconnects) == (life, 0)
        a.close()
        b.close()
