"""PageServer: one page for browsers on this computer; its files, a stream of its content, its messages.

Only programs of this computer reach 127.0.0.1, but every page that a browser on it has open can send
requests there. So a request is answered only if it knows a random token, which is in the page's address;
names this very address as its host, which a foreign name that was made to point here does not (DNS
rebinding); and comes from no other origin. Everything else gets 403, and no header permits another origin.

What the page shows goes out as server-sent events (WHATWG HTML, 9.2) over one connection, whose end tells
at once that the page is gone; what it sends are small requests over connections that stay open.
"""

from __future__ import annotations

import json
import os
import secrets
import select
import socket
import socketserver
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from stickslip_fit._json import to_plain
from stickslip_fit._summary import load_template
from stickslip_fit.errors import InputError

LOOPBACK = "127.0.0.1"
MAX_CLIENTS = 3  # a browser keeps at most six connections to a server open, and each page holds one for good
MAX_BYTES = 4096  # of a message
SEND_SECONDS = 2.0  # after which a page that does not read is given up
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address has the token
    "X-Content-Type-Options": "nosniff",
}
MEDIA_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript"}


class RefusalError(Exception):
    """A request that is not answered: its HTTP status, and why."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        self.status = status
        super().__init__(reason)


class PageContent(ABC):
    """What a page shows, and what it is told. Called from several threads.

    Attributes
    ----------
    address : str
        Of the page while it is served, with its token: to be shown to the user.
    """

    def __init__(self) -> None:
        self.address = ""
        self._lock = threading.Lock()

    def join(self, client: str) -> None:  # noqa: B027 (nothing, unless it matters who looks on)
        """A browser has opened the page."""

    def leave(self, client: str) -> None:  # noqa: B027
        """It has closed the page, or has gone."""

    @abstractmethod
    def content(self, client: str) -> dict[str, Any]:
        """What it shows now; numbers that are not finite become null."""

    @abstractmethod
    def receive(self, message: bytes) -> None:
        """What a page says; raises RefusalError."""


@dataclass(frozen=True)
class PageFiles:
    """The files of a page by name; the page itself is ``""``."""

    bodies: Mapping[str, tuple[str, bytes]]

    @classmethod
    def load(cls, page: str, *assets: str, **values: Any) -> PageFiles:
        """A template, filled in, and the files beside it."""
        bodies = {"": (MEDIA_TYPES["html"], load_template(page).render(**values).encode("utf-8"))}
        for name in assets:
            body = files("stickslip_fit").joinpath("templates", name).read_bytes()
            bodies[name] = (MEDIA_TYPES[name.rpartition(".")[2]], body)
        return cls(bodies)


@contextmanager
def serve_page[Content: PageContent](
    page_files: PageFiles, page_content: Content, period: float, port: int = 0
) -> Iterator[Content]:
    """Serve a page while the context lasts.

    Parameters
    ----------
    period : float
        Between two events, s.
    port : int
        Any free one by default.

    Yields
    ------
    PageContent
        The same, with the page's address.

    Raises
    ------
    InputError
        If the port is in use, or not permitted.
    """
    try:
        server = PageServer(page_files, page_content, period, port)
    except (OSError, OverflowError) as error:
        raise InputError(
            f"no page can be served at {LOOPBACK}, port {port} ({error}); give another port, or none for any "
            "that is free"
        ) from None
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), name="page", daemon=True)
    thread.start()
    try:
        page_content.address = server.address
        yield page_content
    finally:
        server.shutdown()
        server.end()
        thread.join()


class PageServer(ThreadingHTTPServer):
    """The server of a drive's page, bound to the loopback address alone."""

    daemon_threads = True
    allow_reuse_address = os.name == "posix"  # elsewhere two programs could serve one port

    def __init__(self, page_files: PageFiles, page_content: PageContent, period: float, port: int) -> None:
        self.page_files = page_files
        self.page_content = page_content
        self.period = period
        self.token = secrets.token_urlsafe(24)
        self.ending = threading.Event()
        self._lock = threading.Condition()
        self._connections: set[socket.socket] = set()
        self._clients: set[str] = set()
        super().__init__((LOOPBACK, port), _Handler)

    @property
    def host(self) -> str:
        """As browsers name it."""
        return f"{LOOPBACK}:{self.server_address[1]}"

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://{self.host}/{self.token}/"

    def server_bind(self) -> None:
        """Without the look-up of the computer's name, which takes seconds in some networks."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = LOOPBACK, self.server_address[1]

    def end(self) -> None:
        """Tell the pages that there is no more, and close all connections."""
        self.ending.set()
        with self._lock:
            connections = set(self._connections)
        for connection in connections:
            with suppress(OSError):  # closed meanwhile
                connection.shutdown(socket.SHUT_RD)
        with self._lock:  # the streams end with a last event, for which the program may not be too quick
            self._lock.wait_for(lambda: not self._clients, SEND_SECONDS)
        self.server_close()

    def connect(self, connection: socket.socket) -> None:
        """Note an open connection."""
        with self._lock:
            self._connections.add(connection)

    def disconnect(self, connection: socket.socket) -> None:
        """Note that it is closed."""
        with self._lock:
            self._connections.discard(connection)

    def admit(self) -> str:
        """A name for a page that was opened; raises RefusalError if too many are."""
        client = secrets.token_urlsafe(9)
        with self._lock:
            if len(self._clients) >= MAX_CLIENTS:
                reason = f"{MAX_CLIENTS} pages are open already; close one"
                raise RefusalError(HTTPStatus.SERVICE_UNAVAILABLE, reason)
            self._clients.add(client)
        self.page_content.join(client)
        return client

    def dismiss(self, client: str) -> None:
        """The page was closed."""
        with self._lock:
            self._clients.discard(client)
            self._lock.notify_all()
        self.page_content.leave(client)


class _Handler(BaseHTTPRequestHandler):
    """The requests of one connection."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # it would hold small answers back for 40 ms
    server: PageServer

    def setup(self) -> None:
        super().setup()
        self.server.connect(self.connection)

    def finish(self) -> None:
        self.server.disconnect(self.connection)
        with suppress(OSError):
            super().finish()

    def handle(self) -> None:
        with suppress(OSError):
            super().handle()

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the terminal belongs to the drive or the capture."""

    def do_GET(self) -> None:
        """The page, a file of it, or the stream of its content."""
        with self._refusing():
            name = self._checked_name()
            if name == "events":
                return self._stream()
            if name not in self.server.page_files.bodies:
                raise RefusalError(HTTPStatus.NOT_FOUND, "there is no such file")
            self._answer(HTTPStatus.OK, *self.server.page_files.bodies[name])

    def do_POST(self) -> None:
        """A message."""
        with self._refusing():
            if self._checked_name() != "messages":
                raise RefusalError(HTTPStatus.METHOD_NOT_ALLOWED, "nothing is sent there")
            if self.headers["Origin"] is None:
                raise RefusalError(HTTPStatus.FORBIDDEN, "a message needs an Origin")
            # Of a form of another page, a browser would ask no permission.
            if self.headers.get_content_type() != "application/json":
                raise RefusalError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a message is JSON")
            length = self.headers["Content-Length"] or ""
            if not length.isdecimal() or len(length) > 9:
                raise RefusalError(HTTPStatus.LENGTH_REQUIRED, "a message needs a Content-Length")
            if int(length) > MAX_BYTES:
                raise RefusalError(
                    HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a message has at most {MAX_BYTES} bytes"
                )
            self.server.page_content.receive(self.rfile.read(int(length)))
            self._answer(HTTPStatus.NO_CONTENT)

    def _do_other(self) -> None:
        with self._refusing():
            self._checked_name()
            raise RefusalError(HTTPStatus.METHOD_NOT_ALLOWED, "only GET and POST are answered")

    do_HEAD = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_TRACE = do_CONNECT = _do_other

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except RefusalError as refusal:
            self.close_connection = True  # what else it sent is not read
            self._answer(refusal.status, "text/plain", str(refusal).encode("utf-8"))

    def _checked_name(self) -> str:
        """The name after the token; raises RefusalError."""
        server, origin = self.server, self.headers["Origin"]
        if self.headers.get_all("Host") != [server.host]:
            raise RefusalError(HTTPStatus.FORBIDDEN, f"this is {server.host}, and has no other name")
        if origin is not None and origin != f"http://{server.host}":
            raise RefusalError(HTTPStatus.FORBIDDEN, "no other origin is answered")
        # Set by browsers, and not by pages; a link on another page does not lead here either.
        if self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise RefusalError(HTTPStatus.FORBIDDEN, "copy the address into the browser's address bar")
        start, token, name = (*self.path.split("/", 2), "", "")[:3]
        if start or not secrets.compare_digest(token.encode(), server.token.encode()):
            raise RefusalError(HTTPStatus.FORBIDDEN, "the address is the one that was printed, all of it")
        return name

    def _answer(self, status: HTTPStatus, media_type: str = "", body: bytes = b"") -> None:
        self.send_response(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        if status != HTTPStatus.NO_CONTENT:
            self.send_header("Content-Type", f"{media_type}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
        if status == HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, POST")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def version_string(self) -> str:
        """Nothing about versions."""
        return "stickslip-fit"

    def _stream(self) -> None:
        """Events until the page or the server is gone."""
        client = self.server.admit()
        self.close_connection = True  # afterwards
        try:
            self.connection.settimeout(SEND_SECONDS)
            self.send_response(HTTPStatus.OK)
            for name, value in HEADERS.items() | {("Content-Type", "text/event-stream; charset=utf-8")}:
                self.send_header(name, value)
            self.end_headers()
            while not self.server.ending.is_set():
                self._send({"client": client} | self.server.page_content.content(client))
                readable, _, _ = select.select([self.connection], [], [], self.server.period)
                # A page sends nothing more on this connection, so that this is its end.
                if readable and not self.server.ending.is_set():
                    return
            last = self.server.page_content.content(client)
            self._send({"client": client} | last | {"ended": True})
        except OSError:
            pass
        finally:
            self.server.dismiss(client)

    def _send(self, content: dict[str, Any]) -> None:
        text = json.dumps(to_plain(content), separators=(",", ":"), allow_nan=False)
        self.wfile.write(f"data: {text}\n\n".encode())
