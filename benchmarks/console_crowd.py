"""Load a pilot console with twenty pages that read, one page that reads 1 kB/s, and an attacker.

    python benchmarks/console_crowd.py URL --seconds 30       the address that `trimtab console` printed

`benchmarks/console.py` starts this program during a flight, and measures the effect on the flight.
"""

import argparse
import asyncio
import contextlib
import time
import urllib.error
import urllib.request
from urllib.parse import urlsplit

import websockets

PAGES, SLOW_BYTES = 20, 1000
TRY_PERIOD = 0.2
ORIGIN = "http://elsewhere.example"


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_):
        return None


def fetch_cookie(url: str) -> str:
    """Return the cookie that the console gives in exchange for the token in the address."""
    try:
        urllib.request.build_opener(_NoRedirect).open(url, timeout=10)
    except urllib.error.HTTPError as answer:
        with answer:
            return answer.headers["Set-Cookie"].partition(";")[0]
    raise SystemExit(f"{url} is not the address of a console")


async def read_all(host: str, cookie: str, seconds: float) -> int:
    """Read as a normal page. Return the number of rows received."""
    rows, end = 0, time.monotonic() + seconds
    async with websockets.connect(
        f"ws://{host}/live", origin=f"http://{host}", additional_headers={"Cookie": cookie}
    ) as page:
        while time.monotonic() < end:
            rows += isinstance(await page.recv(), bytes)
    return rows


async def read_slowly(host: str, cookie: str, seconds: float) -> int:
    """Read as a page on a slow link. Return the number of bytes received."""
    name, _, port = host.partition(":")
    reader, writer = await asyncio.open_connection(name, int(port), limit=SLOW_BYTES)
    head = (
        f"GET /live HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nCookie: {cookie}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )
    writer.write(head.encode())
    came, end = 0, time.monotonic() + seconds
    while time.monotonic() < end and (data := await reader.read(SLOW_BYTES // 10)):
        came += len(data)
        await asyncio.sleep(0.1)
    writer.close()
    return came


async def attack(host: str, cookie: str, seconds: float) -> int:
    """Guess tokens, use a wrong origin, send 10 MB, and send invalid JSON. Return the number of attempts."""
    tries, end = 0, time.monotonic() + seconds
    own = {"Cookie": cookie}
    while time.monotonic() < end:
        with contextlib.suppress(Exception):  # each attempt must be rejected, with any error
            if tries % 4 == 0:
                await asyncio.to_thread(urllib.request.urlopen, f"http://{host}/?token=guess{tries}", timeout=2)
            elif tries % 4 == 1:
                await websockets.connect(f"ws://{host}/live", origin=ORIGIN, additional_headers=own)
            else:
                async with websockets.connect(
                    f"ws://{host}/live", origin=f"http://{host}", additional_headers=own
                ) as page:
                    await page.send("x" * 10_000_000 if tries % 4 == 2 else b"\x00\xff" * 1000)
                    await page.recv()
        tries += 1
        await asyncio.sleep(TRY_PERIOD)
    return tries


async def crowd(url: str, seconds: float) -> None:
    """Run all readers and the attacker at the same time."""
    host, cookie = urlsplit(url).netloc, fetch_cookie(url)
    pages = [read_all(host, cookie, seconds) for _ in range(PAGES)]
    *rows, slow, tries = await asyncio.gather(
        *pages, read_slowly(host, cookie, seconds), attack(host, cookie, seconds), return_exceptions=True
    )
    print(f"{PAGES} pages: {rows} rows each; the slow one {slow} bytes; {tries} attempts of a stranger")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url", metavar="URL")
    parser.add_argument("--seconds", type=float, default=30.0)
    given = parser.parse_args()
    asyncio.run(crowd(given.url, given.seconds))


if __name__ == "__main__":
    main()
