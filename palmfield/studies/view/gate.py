"""Gate in front of the server of the page: it checks clients, address and token.

This gate listens at the address of the page, reads the head of each connection, and forwards allowed connections. viser
itself would serve every client at a local port, and a script of any web page could find this port by trial.
`only_for_gate` makes viser serve only this gate, which sends a secret.
"""

import asyncio
import contextlib
import errno
import hmac
import http
import ipaddress
import threading
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

from palmfield.errors import OutputError

HEAD_BYTES = 32768
"""Largest head of a request [bytes]."""
HEAD_S = 10.0
"""Longest wait for the head of a request [s]."""
CHUNK = 1 << 16
LOCAL = ("localhost", "127.0.0.1", "::1")
PORTS = 20
"""Number of ports that are tried if no port is requested."""
ALIVE = "/alive"
"""Path whose only purpose is to show that the server runs."""
SECRET_HEADER = "X-Palmfield-Gate"
"""Header of a request by which the server identifies the gate."""


@contextlib.contextmanager
def only_for_gate(secret: str, head: str) -> Iterator[None]:
    """Let a viser server that is started in this block refuse requests without a secret in SECRET_HEADER.

    head: HTML that is added to the head of its page
    Raises OutputError if viser did not start its server as version 1.1 does.
    """
    import websockets.asyncio.server as library

    plain = library.serve
    guarded = []

    def serve(*arguments: Any, process_request: Callable[..., Any], **more: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            if request.headers.get_all(SECRET_HEADER) != [secret]:
                return connection.respond(http.HTTPStatus.FORBIDDEN, "open the address that `palmfield view` printed\n")
            if request.path == ALIVE:
                return connection.respond(http.HTTPStatus.NO_CONTENT, "")
            if request.path.partition("?")[0] != "/" or "Upgrade" in request.headers:
                return process_request(connection, request)
            del request.headers["Accept-Encoding"]
            answer = process_request(connection, request)
            answer.body = answer.body.replace(b"<head>", b"<head>" + head.encode(), 1)
            del answer.headers["Content-Length"]
            answer.headers["Content-Length"] = str(len(answer.body))
            return answer

        guarded.append(True)
        return plain(*arguments, process_request=checked, **more)

    library.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        library.serve = plain  # type: ignore[misc]
    if not guarded:
        raise OutputError("this version of viser cannot be protected from other programs; install viser 1.1")


def is_loopback(host: str) -> bool:
    """Return whether an address can be reached only from this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Head:
    """The head of a request: method, path with query, and headers by lower-case name."""

    def __init__(self, raw: bytes) -> None:
        """Parse a head. Raises ValueError if it is not HTTP/1.1."""
        lines = raw.decode("latin-1").split("\r\n")
        self.method, self.target, version = lines[0].split(" ")
        if version != "HTTP/1.1":
            raise ValueError(version)
        self.headers: dict[str, str] = {}
        for line in lines[1:]:
            name, colon, value = line.partition(":")
            if not colon or name.lower() in self.headers:
                # The forwarded server could read a repeated header differently
                raise ValueError(line)
            self.headers[name.lower()] = value.strip()

    @property
    def cookies(self) -> dict[str, str]:
        pairs = (part.strip().partition("=") for part in self.headers.get("cookie", "").split(";"))
        return {name: value for name, _, value in pairs}


class Refused(Exception):
    """A connection that is not allowed. status, words: status and text of the answer; headers: additional headers"""

    def __init__(self, status: http.HTTPStatus, words: str, headers: str = "") -> None:
        super().__init__(words)
        self.status, self.words, self.headers = status, words, headers

    @property
    def answer(self) -> bytes:
        body = f"{self.words}\n".encode()
        return (
            f"HTTP/1.1 {self.status.value} {self.status.phrase}\r\n{self.headers}Content-Type: text/plain; "
            f"charset=utf-8\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
        ).encode() + body


def check(head: Head, token: str, cookie: str) -> None:
    """Raise Refused for a request that is not allowed. Refused is also raised to redirect a request with a token.

    token: token that a request must have, empty for a page at a loopback address; the Host header must then be a name
        of this machine
    cookie: name of the cookie with the token
    """
    host = head.headers.get("host", "")
    origin = head.headers.get("origin")
    if origin is not None and urlsplit(origin).netloc != host:
        # A script of another site in this user's browser
        raise Refused(http.HTTPStatus.FORBIDDEN, f"the page of {origin} may not use this one")
    if not token:
        if not is_loopback(urlsplit(f"//{host}").hostname or ""):
            # A foreign name that resolves to this machine
            raise Refused(http.HTTPStatus.FORBIDDEN, f"this page is served at {' or '.join(LOCAL)}, not at '{host}'")
        return
    target = urlsplit(head.target)
    tokens = parse_qs(target.query).get("token", [])
    if tokens and hmac.compare_digest(tokens[0].encode(), token.encode()):
        raise Refused(
            http.HTTPStatus.SEE_OTHER, "see the new address",
            f"Location: {target.path}\r\nSet-Cookie: {cookie}={quote(token)}; Path=/; HttpOnly; SameSite=Strict\r\n",
        )  # fmt: skip
    if not hmac.compare_digest(head.cookies.get(cookie, "").encode(), quote(token).encode()):
        raise Refused(
            http.HTTPStatus.FORBIDDEN, "this page needs its token: open the address that `palmfield view` printed"
        )


class Gate:
    """Listens in a separate thread. port: number of its port"""

    def __init__(self, host: str, port: int | None, first: int, behind: int, token: str, secret: str) -> None:
        """port: port to listen at; None for the first free port from `first` on
        behind: port of this machine to which connections are forwarded
        secret: secret that this server expects

        Raises OutputError for an address at which it cannot listen.
        """
        self._behind, self._token, self._secret = behind, token, secret
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        self.port = 0
        tried = [port] if port is not None else list(range(first, first + PORTS))
        for number in tried:
            try:
                asyncio.run_coroutine_threadsafe(self._listen(host, number), self._loop).result()
                return
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise OutputError(
                        f"cannot listen at {host}, port {number}; give another --host or --port"
                    ) from None
        ports = f"port {tried[0]} is" if len(tried) == 1 else f"ports {tried[0]} to {tried[-1]} are"
        raise OutputError(f"{ports} in use at {host}; give another --port")

    async def _listen(self, host: str, port: int) -> None:
        server = await asyncio.start_server(self._meet, host, port, limit=HEAD_BYTES)
        self.port = server.sockets[0].getsockname()[1]

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            try:
                raw = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
                check(Head(raw[:-4]), self._token, f"palmfield_{self.port}")
            except ValueError:
                writer.write(Refused(http.HTTPStatus.BAD_REQUEST, "this is not an HTTP/1.1 request").answer)
                await writer.drain()
            except Refused as refused:
                writer.write(refused.answer)
                await writer.drain()
            else:
                # One check is enough: a connection carries one request or becomes a websocket
                await self._pass_on(raw, reader, writer)
        writer.close()

    async def _pass_on(self, raw: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inside, outside = await asyncio.open_connection("127.0.0.1", self._behind)
        request, end, headers = raw.partition(b"\r\n")
        outside.write(request + end + f"{SECRET_HEADER}: {self._secret}\r\n".encode() + headers)
        both = [asyncio.ensure_future(_copy(reader, outside)), asyncio.ensure_future(_copy(inside, writer))]
        await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        # If one side ends, both end, after the data in transit are sent
        await asyncio.wait(both, timeout=1.0)
        for one in both:
            one.cancel()
        outside.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(CHUNK):
            writer.write(data)
            await writer.drain()
        if writer.can_write_eof():
            writer.write_eof()
