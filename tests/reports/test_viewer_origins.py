"""The viewer's WebSocket answers its own page, and pages of nobody else."""

from __future__ import annotations

import socket

import pytest

from climbplan.reports.viewer.origins import is_own_origin

OWN = [
    (None, "localhost:8080", "127.0.0.1"),
    ("http://localhost:8080", "localhost:8080", "127.0.0.1"),
    ("http://127.0.0.1:8080", "127.0.0.1:8080", "127.0.0.1"),
    ("http://[::1]:8080", "[::1]:8080", "::1"),
    ("http://192.168.0.7:8080", "192.168.0.7:8080", "0.0.0.0"),
    ("http://desk:8080", "desk:8080", "desk"),
]
OTHERS = [
    ("http://evil.example", "localhost:8080", "127.0.0.1"),
    ("http://localhost:9999", "localhost:8080", "127.0.0.1"),
    ("http://evil.example:8080", "evil.example:8080", "127.0.0.1"),  # its name leads here
    ("http://evil.example:8080", "evil.example:8080", "0.0.0.0"),
    ("null", "localhost:8080", "127.0.0.1"),
    ("file://", "localhost:8080", "127.0.0.1"),
    ("http://localhost:8080", None, "127.0.0.1"),
]


@pytest.mark.parametrize("case", OWN)
def test_own_pages(case: tuple[str | None, str | None, str]) -> None:
    assert is_own_origin(*case)


@pytest.mark.parametrize("case", OTHERS)
def test_pages_of_others(case: tuple[str | None, str | None, str]) -> None:
    assert not is_own_origin(*case)


def _upgrade(port: int, origin: str) -> str:
    """The first line of the answer to a WebSocket request."""
    lines = (
        "GET / HTTP/1.1", f"Host: localhost:{port}", f"Origin: {origin}", "Upgrade: websocket",
        "Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13", "", "",
    )  # fmt: skip
    with socket.create_connection(("localhost", port), timeout=10) as stream:
        stream.sendall("\r\n".join(lines).encode())
        return stream.recv(100).decode().splitlines()[0]


def test_the_server_refuses_them() -> None:
    viser = pytest.importorskip("viser")
    from climbplan.reports.viewer.origins import restrict_to_own_origins

    with restrict_to_own_origins("127.0.0.1"):
        server = viser.ViserServer("127.0.0.1", 18080, verbose=False)
    try:
        port = server.get_port()
        assert "403" in _upgrade(port, "http://evil.example")
        assert "101" in _upgrade(port, f"http://localhost:{port}")
    finally:
        server.stop()
