"""Who may come to the live view's page, and who may not."""

import http.client
import socket
import threading

import pytest

from palmfield.errors import OutputError
from palmfield.studies.view.gate import Gate, Head, Refused, check, is_loopback

TOKEN = "a-token_of-some-length"


def head(target="/", **headers):
    """A request's head as a browser sends it."""
    lines = [f"{name.replace('_', '-')}: {value}" for name, value in ({"Host": "localhost:8080"} | headers).items()]
    return Head("\r\n".join([f"GET {target} HTTP/1.1", *lines]).encode())


@pytest.mark.parametrize("host", ["localhost:8080", "127.0.0.1:9", "127.0.0.2:9", "[::1]:8080", "localhost"])
def test_this_machine_comes_in_without_a_token(host):
    check(head(Host=host), "", "c")
    check(head(Host=host, Origin=f"http://{host}"), "", "c")


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example:8080"},  # a name that its owner points at 127.0.0.1
        {"Host": "localhost:8080", "Origin": "http://evil.example"},  # another site's script
        {"Host": "localhost:8080", "Origin": "http://localhost:9999"},
        {"Host": "localhost:8080", "Origin": "null"},
        {"Host": ""},
        {"Host": "127.0.0.1.evil.example:8080"},
    ],
)
def test_other_names_and_other_sites_are_refused(headers):
    with pytest.raises(Refused) as refused:
        check(head(**headers), "", "c")
    assert refused.value.status == 403


def test_the_token_in_the_address_becomes_a_cookie():
    with pytest.raises(Refused) as refused:
        check(head(f"/?token={TOKEN}", Host="lab:8080"), TOKEN, "c")
    answer = refused.value.answer.decode()
    assert (
        answer.startswith("HTTP/1.1 303") and f"Set-Cookie: c={TOKEN}; " in answer and "\r\nLocation: /\r\n" in answer
    )
    assert "HttpOnly" in answer and "SameSite=Strict" in answer
    check(head(Host="lab:8080", Cookie=f"other=1; c={TOKEN}"), TOKEN, "c")


@pytest.mark.parametrize(
    ("target", "headers"),
    [
        ("/", {}),
        ("/?token=", {}),
        (f"/?token={TOKEN}x", {}),
        (f"/?token={TOKEN[:-1]}", {}),
        ("/", {"Cookie": "c=wrong"}),
        ("/", {"Cookie": f"d={TOKEN}"}),
        ("/", {"Cookie": f"c={TOKEN}", "Origin": "http://evil.example"}),
        ("/", {"Cookie": "c=\u00e9"}),
    ],
)
def test_nobody_comes_in_without_the_token(target, headers):
    with pytest.raises(Refused) as refused:
        check(head(target, **headers), TOKEN, "c")
    assert refused.value.status == 403
    assert TOKEN not in refused.value.answer.decode()


@pytest.mark.parametrize(
    "raw", [b"", b"GET /", b"GET / HTTP/1.0", b"GET / HTTP/1.1\r\nHost: a\r\nHost: b", b"GET / HTTP/1.1\r\nno colon"]
)
def test_what_is_no_request_is_refused(raw):
    with pytest.raises(ValueError):
        Head(raw)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost"])
def test_which_addresses_are_this_machines_own(host):
    assert is_loopback(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.4", "lab", ""])
def test_which_addresses_others_reach(host):
    assert not is_loopback(host)


@pytest.fixture
def behind():
    """A server that answers one request a connection, as the page's own does."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        while True:
            try:
                talk, _ = server.accept()
            except OSError:
                return
            with talk:
                talk.recv(65536)
                talk.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 6\r\n\r\ninside")

    threading.Thread(target=serve, daemon=True).start()
    yield server.getsockname()[1]
    server.close()


def asked(port, target="/", **headers):
    talk = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
    talk.request("GET", target, headers=headers)
    answer = talk.getresponse()
    return answer.status, answer.read()


def test_a_gate_passes_on_who_may_and_answers_the_others(behind):
    gate = Gate("127.0.0.1", 0, 0, behind, TOKEN, "s")
    cookie = f"palmfield_{gate.port}={TOKEN}"
    assert asked(gate.port, Cookie=cookie) == (200, b"inside")
    assert asked(gate.port)[0] == 403
    assert asked(gate.port, f"/?token={TOKEN}")[0] == 303
    with socket.create_connection(("127.0.0.1", gate.port), timeout=10.0) as talk:
        talk.sendall(b"nonsense\r\n\r\n")
        assert talk.recv(1000).startswith(b"HTTP/1.1 400")
    with socket.create_connection(("127.0.0.1", gate.port), timeout=10.0) as talk:
        # A second request behind one that was let in does not reach anybody
        talk.sendall(f"GET / HTTP/1.1\r\nHost: a\r\nCookie: {cookie}\r\n\r\nGET / HTTP/1.1\r\nHost: a\r\n\r\n".encode())
        received = b""
        while data := talk.recv(1000):
            received += data
        assert received.count(b"inside") == 1


def test_a_port_that_is_taken_is_told_and_the_next_is_tried(behind):
    with pytest.raises(OutputError, match=f"port {behind} is in use"):
        Gate("127.0.0.1", behind, 0, behind, "", "")
    assert Gate("127.0.0.1", None, behind, behind, "", "").port > behind


def test_an_address_that_is_not_this_machines_is_told():
    with pytest.raises(OutputError, match=r"192\.0\.2\.1.*--host"):
        Gate("192.0.2.1", 0, 0, 1, "", "")
