"""The server as a separate process: well-behaved and hostile pages do not affect the flight."""

import asyncio
import json
import os
import signal
import socket
import time
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import websockets
from console.flight import GAIN, HELLO, Flight, parse
from websockets.exceptions import ConnectionClosed, InvalidStatus

from trimtab.console.address import ConsoleAddress
from trimtab.console.process import open_console
from trimtab.core.errors import InputError
from trimtab.core.time import to_seconds
from trimtab.flight.console_packets import END_SILENCE


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *args):
        return None


class Site:
    """A console with a flight behind it."""

    def __init__(self, console):
        self.console, self.flight = console, Flight(console.line)
        self.host = urlsplit(console.url).netloc

    def get(self, path, data=None, **headers):
        """Return status, headers and body. data: body of a POST request."""
        opener = urllib.request.build_opener(_NoRedirect)
        request = urllib.request.Request(f"http://{self.host}{path}", data, headers)
        try:
            with opener.open(request, timeout=10) as answer:
                return answer.status, answer.headers, answer.read()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.headers, error.read()

    def cookie(self, url=None):
        query = urlsplit(url or self.console.url).query
        status, headers, _ = self.get(f"/?{query}")
        assert status == 303
        return headers["Set-Cookie"].partition(";")[0]

    def connect(self, cookie=None, origin=None):
        cookie = self.cookie() if cookie is None else cookie
        return websockets.connect(
            f"ws://{self.host}/live",
            origin=origin or f"http://{self.host}",
            additional_headers={"Cookie": cookie},
            max_queue=1,
        )

    async def wait(self, what, seconds=10.0):
        """Rows go on until something holds."""
        end = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < end, self.flight.wishes[-5:]
            self.flight.send_row()
            self.flight.read()
            await asyncio.sleep(0.02)


@pytest.fixture
def site():
    def describe(line):
        return HELLO

    with open_console(ConsoleAddress(), describe) as console:
        yield Site(console)


async def _collect(socket, kinds, seconds=10.0):
    """Collect messages by type until each of the given kinds has arrived."""
    found, end = {}, time.monotonic() + seconds
    while not set(kinds) <= set(found):
        packet = await asyncio.wait_for(socket.recv(), max(end - time.monotonic(), 0.01))
        if isinstance(packet, bytes):
            found.setdefault("row", []).append(packet)
        else:
            text = json.loads(packet)
            found.setdefault(text["type"], []).append(text)
    return found


@pytest.mark.real_time
def test_requests_without_cookie_are_forbidden(site):
    for path in ("/", "/main.js", "/console.css", "/../server.py", "/live", "/flights/0/rows"):
        status, _, body = site.get(path)
        assert (status, b"printed" in body) == (403, True), path
    assert site.get("/?token=wrong")[0] == 403


@pytest.mark.real_time
def test_page_loads_with_cookie_and_other_folders_do_not(site):
    cookie = site.cookie()
    status, headers, body = site.get("/", Cookie=cookie)
    assert (status, b"<html" in body) == (200, True)
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert site.get("/main.js", Cookie=cookie)[0] == 200
    for path in ("/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "//etc/passwd", "/nothing.js", "/vendor/"):
        assert site.get(path, Cookie=cookie)[0] == 404, path


@pytest.mark.real_time
def test_foreign_host_is_rejected_and_logged(site):
    assert site.get("/", Cookie=site.cookie(), Host="evil.example")[0] == 403
    assert any("evil.example" in note for note in _notes(site))


@pytest.mark.real_time
def test_foreign_origin_request_is_rejected_and_logged(site):
    status, _, _ = site.get("/none", data=b"{}", Cookie=site.cookie(), Origin="http://evil.example")
    assert status == 403
    assert any("evil.example" in note for note in _notes(site))


def _notes(site):
    site.flight.read(0.3)
    return site.flight.notes()


@pytest.mark.real_time
@pytest.mark.parametrize("case", ["no cookie", "wrong cookie", "cross origin", "no origin"])
def test_unauthorised_sockets_are_rejected_and_logged(site, case):
    async def attempt():
        cookie = {"no cookie": "", "wrong cookie": "trimtab_1=x"}.get(case, site.cookie())
        origin = {"cross origin": "http://evil.example", "no origin": "null"}.get(case)
        with pytest.raises(InvalidStatus):
            async with site.connect(cookie, origin):
                pass

    asyncio.run(attempt())
    assert any("refused" in note for note in _notes(site))


@pytest.mark.real_time
def test_page_receives_rows_status_and_events(site):
    async def look():
        async with site.connect() as page:
            hello = (await _collect(page, ["hello"]))["hello"][0]
            assert (hello["title"], hello["role"]) == ("a/test", "pilot")
            site.flight.send("event", t=0.1, text="something happened")
            site.flight.send_row(estimate__age=0.25)
            found = await _collect(page, ["row", "event", "status"])
            t, values = parse(found["row"][0])
            assert t == pytest.approx(0.02)
            assert values["estimate.age"] == pytest.approx(0.25)
            assert found["event"][0]["text"] == "something happened"
            assert found["status"][0]["requests"]["hold"]["allowed"]
        async with site.connect() as late:
            assert (await _collect(late, ["event"]))["event"][0]["text"] == "something happened"

    asyncio.run(look())


@pytest.mark.real_time
def test_requests_reach_the_flight_and_only_the_sender_is_answered(site):
    async def wish():
        async with site.connect() as page, site.connect() as other:
            await page.send(json.dumps({"type": "set", "path": GAIN["path"], "slot": 0, "value": 2.0, "id": 5}))
            await page.send(json.dumps({"type": "stop"}))
            await site.wait(lambda: {"set", "stop"} <= {w["type"] for w in site.flight.wishes})
            wish = next(w for w in site.flight.wishes if w["type"] == "set")
            assert (wish["path"], wish["value"]) == (GAIN["path"], 2.0)
            site.flight.send("value", path=GAIN["path"], slot=0, value=2.0)
            site.flight.send("answer", id=5, client=wish["client"], ok=True, text="done")
            assert (await _collect(page, ["answer"]))["answer"][0]["text"] == "done"
            seen = await _collect(other, ["value"])
            assert "answer" not in seen
        async with site.connect() as late:  # sees the value of now
            assert (await _collect(late, ["hello"]))["hello"][0]["parameters"][0]["value"] == 2.0

    asyncio.run(wish())


@pytest.mark.real_time
def test_only_one_page_holds_the_stick_and_no_release_is_faked(site):
    async def steer():
        async with site.connect() as second:
            async with site.connect() as first:
                stick = json.dumps({"type": "stick", "forward": 1.0, "turn": 0.0, "mode": 1})
                await first.send(stick)  # without having taken it
                await first.send(json.dumps({"type": "take", "id": 1}))
                assert (await _collect(first, ["answer"]))["answer"][0]["ok"]
                await second.send(json.dumps({"type": "take", "id": 2}))
                refused = (await _collect(second, ["answer"]))["answer"][0]
                assert not refused["ok"]
                assert "has the stick" in refused["text"]
                await second.send(stick)
                await first.send(stick)
                await site.wait(lambda: any(w["type"] == "stick" for w in site.flight.wishes))
                taken = next(w["pilot"] for w in site.flight.wishes if w["type"] == "take")
                assert [w["pilot"] for w in site.flight.wishes if w["type"] == "stick"] == [taken]
            site.flight.read(0.5)
            assert not any(w["type"] == "release" for w in site.flight.wishes)
            await second.send(json.dumps({"type": "take", "id": 3}))
            assert (await _collect(second, ["answer"]))["answer"][0]["ok"]

    asyncio.run(steer())


@pytest.mark.real_time
def test_frozen_page_loses_the_stick(site):
    """By then, the dead man's switch has ended the flight."""

    async def take():
        async with site.connect() as first, site.connect() as second:
            await first.send(json.dumps({"type": "take", "id": 1}))
            assert (await _collect(first, ["answer"]))["answer"][0]["ok"]
            began = time.monotonic()
            while not (await _ask_for_the_stick(second))["ok"]:
                assert time.monotonic() - began < 10.0
                await asyncio.sleep(0.1)
            assert time.monotonic() - began > to_seconds(END_SILENCE)

    async def _ask_for_the_stick(page):
        await page.send(json.dumps({"type": "take", "id": 2}))
        return (await _collect(page, ["answer"]))["answer"][0]

    asyncio.run(take())


@pytest.mark.real_time
def test_observers_receive_rows_but_cannot_command(site):
    async def look():
        async with site.connect(site.cookie(site.console.observer)) as page:
            assert (await _collect(page, ["hello"]))["hello"][0]["role"] == "observer"
            await page.send(json.dumps({"type": "stop"}))
            with pytest.raises(ConnectionClosed):
                await _collect(page, ["never"])

    asyncio.run(look())
    assert any("observer" in note for note in _notes(site))
    assert not any(w["type"] == "stop" for w in site.flight.wishes)


HOSTILE = {
    "no json": "}{",
    "a message of 10 MB": "x" * 10_000_000,
    "binary": b"\x00\xff" * 100,
    "an unknown type": '{"type": "note", "text": "in the log"}',
    "nan value": '{"type": "set", "path": "a", "slot": 0, "value": NaN, "id": 1}',
    "a flood": ['{"type": "ping", "sent": 1}'] * 2000,
}


async def _send_and_listen(page, packets):
    for packet in packets if isinstance(packets, list) else [packets]:
        await page.send(packet)
    await _collect(page, ["never"])


@pytest.mark.real_time
@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_pages_are_closed_and_other_pages_continue(site, case):
    async def attack():
        async with site.connect() as good, site.connect() as bad:
            with pytest.raises(ConnectionClosed):
                await _send_and_listen(bad, HOSTILE[case])
            await site.wait(lambda: any("closed" in note for note in site.flight.notes()))
            site.flight.send_row(estimate__age=0.3)
            assert (await _collect(good, ["row"]))["row"]

    asyncio.run(attack())
    assert all(w["type"] in ("note", "ping") for w in site.flight.wishes)


@pytest.mark.real_time
def test_slow_page_skips_rows_and_gets_the_newest(site):
    """The slow page reads nothing for seconds over a small socket buffer; other pages get every row meanwhile."""

    async def crawl():
        async with site.connect() as good, site.connect() as slow:
            await _collect(slow, ["hello"])
            slow.transport.pause_reading()
            got = []
            for _ in range(150):
                site.flight.send_row()
                await asyncio.sleep(0.01)
                got += (await _collect(good, ["row"]))["row"]
            assert len(got) >= 100
            slow.transport.resume_reading()
            await asyncio.sleep(0.2)
            site.flight.send_row()
            last = site.flight.t
            rows = []
            while not rows or parse(rows[-1])[0] < last - 1e-9:
                rows += (await _collect(slow, ["row"]))["row"]
            assert parse(rows[-1])[0] == pytest.approx(last)

    asyncio.run(crawl())


@pytest.mark.real_time
def test_page_that_reads_nothing_is_disconnected_once_its_buffers_are_full(site):
    """Buffers of the kernel take data for a while, here about a second. Five seconds later the page is closed."""

    async def fill():
        async with site.connect() as good, site.connect() as deaf:
            await _collect(deaf, ["hello"])
            deaf.transport.pause_reading()
            began = time.monotonic()
            while not any("accepted no data for 5 s" in note for note in site.flight.notes()):
                assert time.monotonic() - began < 60.0
                for _ in range(10):
                    site.flight.send("event", t=0.0, text="x" * 10_000)
                site.flight.read()
                await _collect(good, ["event"])
            assert time.monotonic() - began > 5.0
            site.flight.send_row(estimate__age=0.3)
            assert (await _collect(good, ["row"]))["row"]

    asyncio.run(fill())


@pytest.mark.real_time
def test_alarms_are_shown_acknowledged_and_logged(site):
    async def alarm():
        async with site.connect() as page:
            site.flight.send_row(supervisor__mode=4.0, supervisor__cause=9.0)
            await site.wait(lambda: any("alarm: fault" in note for note in site.flight.notes()))
            await page.send(json.dumps({"type": "acknowledge", "alarm": "supervisor-fault"}))
            await site.wait(lambda: any("acknowledged" in note for note in site.flight.notes()))
            found = await _collect(page, ["status"])
            while not any(a["acknowledged"] for a in found["status"][-1]["alarms"]):
                site.flight.send_row()
                found = await _collect(page, ["status"])
            site.flight.values["supervisor.mode"] = 1.0
            await site.wait(lambda: any("cleared: fault" in note for note in site.flight.notes()))

    asyncio.run(alarm())


@pytest.mark.real_time
def test_page_is_notified_when_the_flight_ends():
    with open_console(ConsoleAddress(), lambda line: HELLO) as console:
        site = Site(console)

        async def end():
            async with site.connect() as page:
                await _collect(page, ["hello"])
                console.line.close()
                assert (await _collect(page, ["end"]))["end"][0]["text"] == "the flight is over"

        asyncio.run(end())


@pytest.mark.real_time
def test_stopped_server_does_not_block_the_flight(site):
    """While the server's process is stopped, sending rows takes no time, and rows beyond its buffer are dropped."""
    server = find_child(b"trimtab.console.server")
    os.kill(server, signal.SIGSTOP)
    try:
        began = time.monotonic()
        for _ in range(3000):
            site.flight.send_row()
        assert time.monotonic() - began < 1.0
    finally:
        os.kill(server, signal.SIGCONT)


def find_child(module):
    """Return the process of this program's child that runs a module."""
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text("ascii").split()
    (found,) = [int(child) for child in children if module in Path(f"/proc/{child}/cmdline").read_bytes()]
    return found


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.4.1", "::"])
def test_non_local_host_requires_tls(host):
    with pytest.raises(InputError, match='certificate="FILE" private_key="FILE"'):
        ConsoleAddress(host=host).check()


@pytest.mark.real_time
def test_rejects_a_port_in_use():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match="port=0"), open_console(ConsoleAddress(port=port), lambda line: HELLO):
            pass
