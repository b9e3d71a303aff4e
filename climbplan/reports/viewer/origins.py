"""Accept connections of a viewer or of the live page from its own pages only.

Browsers let every page connect to every address, this machine's own included, and say in the header
Origin which page asks. Programs that are no browsers send none, and read nothing of a user's.
"""

from __future__ import annotations

import http
import ipaddress
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

_LOOPBACK = {"localhost", "127.0.0.1", "::1"}


def is_own_origin(origin: str | None, asked_host: str | None, listened: str) -> bool:
    """Return whether a page of the viewer itself asks.

    Args:
        origin: header Origin, None where a program sends none.
        asked_host: header Host, the address that the browser connects to.
        listened: address that the viewer listens on; of this machine alone only its names are own,
            else any address and the machine's name: others could lead here by their name service.
    """
    if origin is None:
        return True
    page = urlsplit(origin)
    name = (page.hostname or "").lower()
    if page.scheme not in ("http", "https") or page.netloc.lower() != (asked_host or "").lower():
        return False
    if name in _LOOPBACK or name == listened.lower():
        return True
    return listened.lower() not in _LOOPBACK and (_is_address(name) or name in _list_host_names())


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _list_host_names() -> set[str]:
    return {socket.gethostname().lower(), socket.getfqdn().lower()}


@contextmanager
def restrict_to_own_origins(listened: str) -> Iterator[None]:
    """Have servers that viser starts in the block refuse connections from pages of others."""
    import websockets.asyncio.server as sockets

    serve = sockets.serve

    def serve_guarded(*arguments: Any, **options: Any) -> Any:
        options["process_request"] = _build_guard(options.get("process_request"), listened)
        return serve(*arguments, **options)

    sockets.serve = serve_guarded  # type: ignore[assignment, misc]  # viser has no option for it
    try:
        yield
    finally:
        sockets.serve = serve  # type: ignore[misc]


def _build_guard(process: Callable[..., Any] | None, listened: str) -> Callable[..., Any]:
    def guarded(connection: Any, request: Any) -> Any:
        headers = request.headers
        is_socket = "websocket" in (headers.get("Upgrade") or "").lower()
        if is_socket and not is_own_origin(headers.get("Origin"), headers.get("Host"), listened):
            refusal = "the viewer accepts connections from its own page only\n"
            return connection.respond(http.HTTPStatus.FORBIDDEN, refusal)
        return None if process is None else process(connection, request)

    return guarded
