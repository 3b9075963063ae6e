import pytest
from flight.transports.ends import EVERY_BYTE, deliver, meet
from flight.transports.relays import LEFT, SerialPair

from trimtab.flight.transports.open_link import open_link

pytestmark = pytest.mark.real_time


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
