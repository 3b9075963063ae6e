"""Process of a console's server. `console.process` starts the process, and writes the settings to its standard input.

The process ends when the flight ends, or when standard input closes because the flying process has ended. It never
blocks the flight.
"""

import asyncio
import json
import os
import signal
import socket
import sys
import webbrowser
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

from trimtab.console.access import HEADERS, OBSERVER, PILOT, Access
from trimtab.console.address import ConsoleAddress, open_listener
from trimtab.console.clients import LARGEST_MESSAGE, VIOLATION, Client
from trimtab.console.live_feed import LiveFeed

PAGE = Path(__file__).parent / "page"
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".png": "image/png",
}
MOST_CLIENTS = 32
NO_COOKIE = "the request has no valid cookie: open the address with the token that was printed at the start"
"""Reason to refuse a request without a valid cookie. It is not logged for HTTP requests, because browsers request an
icon automatically."""
LAST_WORDS = 0.5
"""Time (s) to send the last messages to the pages before the server ends."""


class Guard:
    """Access check of the web application. It refuses requests without a valid cookie, requests that name another host,
    and web sockets from pages of another origin."""

    def __init__(self, app: ASGIApp, access: Access, note: Callable[[str], None]) -> None:
        """note: function that is called with a message for each refused request."""
        self._app, self._access, self._note = app, access, note

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on to the web application, or refuse the request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        refusal = self._find_refusal(scope, headers)
        if refusal:
            if scope["type"] == "websocket" or refusal != NO_COOKIE:
                self._note(f"console: refused: {refusal}")
            await self._refuse(scope, receive, send, refusal)
            return
        scope["role"] = self._access.role(headers)
        await self._app(scope, receive, send)

    def _find_refusal(self, scope: Scope, headers: dict[str, str]) -> str:
        if not self._access.is_own_host(headers.get("host", "")):
            return f"the host {headers.get('host', '')[:80]!r} is not a host name of this server"
        may_change = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if may_change and not self._access.is_own_origin(headers.get("origin", "")):
            return f"a request from the origin {headers.get('origin', '')[:80]!r}"
        is_entrance = scope["type"] == "http" and scope["path"] == "/" and scope["query_string"].startswith(b"token=")
        if not is_entrance and self._access.role(headers) is None:
            return NO_COOKIE
        return ""

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, why: str) -> None:
        if scope["type"] == "websocket":
            await WebSocket(scope, receive, send).close(VIOLATION)
            return
        await PlainTextResponse(why + "\n", 403, HEADERS)(scope, receive, send)


def make_app(access: Access, feed: Any, note: Callable[[str], None], more: list[BaseRoute]) -> ASGIApp:
    """Return the web application of a console.

    Args:
        access: access control.
        feed: source of the pages' data, with the methods join, leave, handle and next_number of `LiveFeed`.
        note: function that is called with a message for each refused request.
        more: additional HTTP routes.
    """

    async def show_page(request: Request) -> Response:
        token = request.query_params.get("token")
        if token is None:
            return _file("index.html")
        cookie = access.exchange(token)
        if cookie is None:
            return PlainTextResponse("wrong token: open the address that was printed last\n", 403, HEADERS)
        return RedirectResponse("/", 303, HEADERS | {"Set-Cookie": cookie})

    async def give_file(request: Request) -> Response:
        return _file(request.path_params["path"])

    async def serve_socket(socket: WebSocket) -> None:
        if len(feed.clients) >= MOST_CLIENTS:
            note(f"console: a page was refused, because {MOST_CLIENTS} pages are already open")
            await socket.close(VIOLATION)
            return
        await socket.accept()
        client = Client(feed.next_number(), socket.scope["role"], socket)
        feed.join(client)
        why = ""
        try:
            why = await client.serve(feed.handle)
        finally:
            feed.leave(client, why)

    routes: list[BaseRoute] = [
        Route("/", show_page),
        WebSocketRoute("/live", serve_socket),
        *more,
        Route("/{path:path}", give_file),
    ]
    return Guard(Starlette(routes=routes), access, note)


def _file(path: str) -> Response:
    """Return a file of the console's page. Files outside the page's folder are refused."""
    file = (PAGE / path).resolve()
    if PAGE not in file.parents or not file.is_file() or file.suffix not in TYPES:
        return PlainTextResponse("no such page\n", 404, HEADERS)
    return FileResponse(file, media_type=TYPES[file.suffix], headers=HEADERS)


async def serve(
    app: ASGIApp,
    listener: socket.socket,
    files: Mapping[str, str | None],
    run: Callable[[], Awaitable[Any]],
    over: asyncio.Event,
) -> None:
    """Serve a web application until `over` is set.

    files: paths of certificate and private_key for TLS, or None.  run: coroutine function that runs in parallel with
    the server.
    """
    config = uvicorn.Config(
        app,
        log_level="critical",
        access_log=False,
        lifespan="off",
        server_header=False,
        ws="websockets-sansio",
        ws_max_size=LARGEST_MESSAGE,
        ws_per_message_deflate=False,
        ssl_certfile=files["certificate"],
        ssl_keyfile=files["private_key"],
    )
    server = uvicorn.Server(config)
    beside = asyncio.ensure_future(run())
    serving = asyncio.ensure_future(server.serve(sockets=[listener]))
    ending = asyncio.ensure_future(over.wait())
    await asyncio.wait((serving, ending, beside), return_when=asyncio.FIRST_COMPLETED)
    await asyncio.sleep(LAST_WORDS)
    server.should_exit = server.force_exit = True
    beside.cancel()
    await asyncio.wait((serving,), timeout=2.0)


async def serve_here(address: ConsoleAddress, feed: Any, routes: list[BaseRoute], tell: Callable[[str], None]) -> None:
    """Serve pages without a live flight until the user interrupts the server. tell: function that is called with a text
    that contains the URL."""
    over = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, over.set)
    with open_listener(address) as listener:
        access = Access(address.host, listener.getsockname()[1], address.certificate is not None, tell)
        app = make_app(access, feed, tell, routes)
        tell(f"console: {access.url(PILOT)}\nopen this address in a browser; Ctrl-C ends the server")
        if address.opens:
            webbrowser.open(access.url(PILOT))
        await serve(app, listener, address.files, over.wait, over)


def watch_parent(over: asyncio.Event) -> None:
    """Set the event `over` when standard input closes, which means that the flying process has ended."""

    def look() -> None:
        if not os.read(sys.stdin.fileno(), 4096):
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
            over.set()

    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), look)


def main() -> None:
    """Serve the console of one flight, with the settings that are read from standard input."""
    orders = json.loads(sys.stdin.readline())
    listener = socket.socket(fileno=orders["listener"])
    port = listener.getsockname()[1]
    notes: list[Callable[[str], None]] = []

    def note(text: str) -> None:
        for each in notes:
            each(text)

    async def start() -> None:
        over = asyncio.Event()
        watch_parent(over)
        access = Access(orders["host"], port, orders.get("certificate") is not None, note)
        feed = LiveFeed(socket.socket(fileno=orders["line"]), orders["hello"], over.set)
        notes.append(feed.note)
        app = make_app(access, feed, note, [])
        print(json.dumps({"url": access.url(PILOT), "observer": access.url(OBSERVER)}), flush=True)
        await serve(app, listener, orders, feed.run, over)

    asyncio.run(start())


if __name__ == "__main__":
    main()
