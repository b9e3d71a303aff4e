"""The server of the live page: this machine only, and only for who has the token of its address.

Browsers let every page send requests to this machine. A request is therefore answered only if its
path begins with the token, its Host is this server's (which defeats names that are rebound to the
loopback address), and its Origin, where a browser sends one, is the live page itself.
"""

from __future__ import annotations

import errno
import json
import secrets
import sys
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import unquote, urlsplit

from markupsafe import Markup

from climbplan.errors import ClimbplanError, SpecError, UsageError
from climbplan.live.fragments import build_comparison, build_outcome, build_replay
from climbplan.live.planning import Planner, PlannerBusy, Run
from climbplan.live.spec_files import check_text, list_specs, read_spec, save_spec
from climbplan.reports.page_parts import build_policy, build_style, read_part
from climbplan.reports.page_template import build_data_element, fill
from climbplan.reports.viewer.origins import is_own_origin
from climbplan.schema.json_schema import json_schema
from climbplan.schema.kinds import KINDS

ADDRESS = "127.0.0.1"
MAX_BODY = 1_000_000  # [bytes] of a request
_MAX_CONNECTIONS = 24  # at the same time
_NUM_PORTS = 50  # that are tried
_PATIENCE = 15.0  # [s] for a client to send its request, and between signs of life to it
_FIRST_SPEC = "climb_tube"  # example that the page begins with
_SCRIPTS = ("live_completion.js", "live.js")


class LiveServer:
    """The live page on a local port, from entering the context until leaving it.

    Args:
        folder: directory that relative paths in specs start from. Specs are saved in it, and plans
            are written below `outputs` in it; nothing is written elsewhere.
        port: the first port to try; 0 takes any.

    Raises:
        UsageError: the folder is no directory, or all ports are taken.
    """

    def __init__(self, folder: Path, port: int) -> None:
        if not folder.is_dir():
            raise UsageError(f"{folder}: no such directory")
        self.folder, self.token = folder.resolve(), secrets.token_urlsafe(24)
        self.planner = Planner(self.folder)
        self._server = _listen(port, self)
        self.port = int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """The address of the page, with its token."""
        return f"http://{ADDRESS}:{self.port}/{self.token}/"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.planner.__exit__()
        self._server.server_close()

    def run(self) -> None:
        """Serve until `stop` or an exception."""
        self._server.serve_forever(poll_interval=0.2)

    def stop(self) -> None:
        """End `run`, which another thread is in."""
        self._server.shutdown()

    def refuse(self, path: str, host: str, origin: str | None) -> str:
        """Return why a request is not answered, by its path and headers; "" if it is."""
        names = {f"{name}:{self.port}" for name in (ADDRESS, "localhost")}
        if host.lower() not in names:
            return "requests have to name this machine as their host"
        if not is_own_origin(origin, host, ADDRESS):
            return "requests of other pages are not answered"
        token = path.lstrip("/").partition("/")[0]
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            return "the address lacks the token that `climbplan serve` printed"
        return ""

    def build_page(self) -> str:
        """Return the live page."""
        script = "\n".join(read_part(name) for name in _SCRIPTS)
        return fill(
            "live.html",
            policy=Markup(f"{build_policy((script,))}; connect-src 'self'; frame-src 'self'"),
            style=Markup(f"{build_style()}\n{read_part('live.css')}"),
            folder=str(self.folder),
            values=build_data_element("live-data", {"kinds": list(KINDS), "first": _FIRST_SPEC})[
                "live-data"
            ],
            script=Markup(script),
        )


def _listen(port: int, live: LiveServer) -> _Server:
    """Return a server on the first free port from `port` on; raises UsageError."""
    for candidate_port in [port] if port == 0 else range(port, min(port + _NUM_PORTS, 65536)):
        try:
            return _Server(candidate_port, live)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise UsageError(f"--port {candidate_port}: {error.strerror}") from None
    raise UsageError(f"--port {port}: taken, as are the {_NUM_PORTS} after it")


class _Server(ThreadingHTTPServer):
    """A server with a bounded number of connections."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, port: int, live: LiveServer) -> None:
        self.live = live
        self._free = threading.BoundedSemaphore(_MAX_CONNECTIONS)
        super().__init__((ADDRESS, port), _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of clients that leave, and everything of bugs."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: _Server
    timeout = _PATIENCE
    server_version, sys_version = "climbplan", ""

    def do_GET(self) -> None:
        """Answer with the page, or a part of it."""
        if (path := self._admit()) is None:
            return
        if path in _PAGES:
            self._answer(lambda: _PAGES[path](self.server.live))
            return
        first, _, subpath = path.partition("/")
        if first == "events":
            self._send_events(subpath)
        elif first in _PARTS:
            self._answer(lambda: _PARTS[first](self.server.live, subpath))
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "no such page")

    def do_POST(self) -> None:
        """Check, save, plan or cancel."""
        if (path := self._admit()) is None:
            return
        if path not in _ACTIONS:
            self._refuse(HTTPStatus.NOT_FOUND, "no such action")
            return
        fields = self._read_body()
        if fields is not None:
            self._answer(lambda: _ACTIONS[path](self.server.live, fields))

    def _admit(self) -> str | None:
        """Return the path below the token; None if the request was refused."""
        path = urlsplit(self.path).path
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        refusal = self.server.live.refuse(path, host, origin)
        if refusal:
            self._refuse(HTTPStatus.FORBIDDEN, refusal)
            return None
        return unquote(path.lstrip("/").partition("/")[2])

    def _read_body(self) -> dict[str, Any] | None:
        """Return the JSON object of the body; None if the request was refused."""
        if self.headers.get_content_type() != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "expected application/json")
            return None
        length = self.headers.get("Content-Length", "")
        if not length.isascii() or not length.isdigit():
            self._refuse(HTTPStatus.LENGTH_REQUIRED, "expected a Content-Length")
            return None
        if int(length) > MAX_BODY:
            self._refuse(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                f"too large: {int(length)} bytes, expected at most {MAX_BODY}",
            )
            return None
        try:
            fields = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            fields = None
        if not isinstance(fields, dict):
            self._refuse(HTTPStatus.BAD_REQUEST, "expected a JSON object")
            return None
        return fields

    def _answer(self, build: Callable[[], str | dict[str, Any]]) -> None:
        """Send what a function returns, HTML or JSON; its errors become answers."""
        try:
            content = build()
        except _NotFound as error:
            self._refuse(HTTPStatus.NOT_FOUND, str(error))
        except PlannerBusy as error:
            self._refuse(HTTPStatus.CONFLICT, str(error))
        except ClimbplanError as error:
            self._refuse(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
        else:
            is_page = isinstance(content, str)
            text = content if isinstance(content, str) else json.dumps(content, allow_nan=False)
            self._send(HTTPStatus.OK, text, "text/html" if is_page else "application/json")

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        self._send(status, json.dumps({"error": reason}), "application/json")

    def _send(self, status: HTTPStatus, text: str, content_type: str) -> None:
        body = text.encode()
        self._begin(status, content_type)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _begin(self, status: HTTPStatus, content_type: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{content_type}; charset=utf-8")
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")  # which would tell the token
        self.send_header("Content-Security-Policy", "frame-ancestors 'self'")

    def _send_events(self, number: str) -> None:
        """Send lines and progress of a run as server-sent events, until it is complete."""
        try:
            run = _find_run(self.server.live, number)
        except _NotFound as error:
            self._refuse(HTTPStatus.NOT_FOUND, str(error))
            return
        self._begin(HTTPStatus.OK, "text/event-stream")
        self.end_headers()
        sent = 0
        for num_lines in self.server.live.planner.follow(run, _PATIENCE):
            event = {
                **run.summarise(),
                "progress": run.progress_text,
                "lines": run.lines[sent:num_lines],
            }
            sent = num_lines
            text = json.dumps(event, allow_nan=False)
            self.wfile.write(f"data: {text}\n\n".encode())
            self.wfile.flush()

    def log_message(self, format: str, *arguments: Any) -> None:
        """Log nothing: requests contain the token."""


class _NotFound(Exception):
    """Something that a path names and that is not there."""


def _find_run(live: LiveServer, number: str) -> Run:
    run = live.planner.find_run(int(number)) if number.isascii() and number.isdigit() else None
    if run is None:
        raise _NotFound(f"no run {number[:20]!r}")
    return run


def _list_all(live: LiveServer) -> dict[str, Any]:
    runs = [run.summarise() for run in live.planner.list_runs()]
    return {**list_specs(live.folder), "runs": runs}


def _send_schema(live: LiveServer, kind: str) -> dict[str, Any]:
    return json_schema(kind)


def _send_spec(live: LiveServer, subpath: str) -> dict[str, Any]:
    source, _, name = subpath.partition("/")
    try:
        return {"text": read_spec(live.folder, source, name)}
    except SpecError as error:
        raise _NotFound(str(error)) from error


def _send_outcome(live: LiveServer, number: str) -> str:
    run = _find_run(live, number)
    if not run.is_complete:
        raise _NotFound("the run is not complete")
    return build_outcome(run)


def _send_replay(live: LiveServer, number: str) -> str:
    run = _find_run(live, number)
    if run.plan_path is None:
        raise _NotFound("the run has no plan")
    return build_replay(run)


def _send_comparison(live: LiveServer, subpath: str) -> str:
    first, _, second = subpath.partition("/")
    return build_comparison(_find_run(live, first), _find_run(live, second))


def _read_text(fields: Mapping[str, Any], name: str) -> str:
    """Return a text of a request; raises UsageError."""
    text = fields.get(name)
    if not isinstance(text, str):
        raise UsageError(f"expected a text {name!r}")
    return text


def _check(live: LiveServer, fields: Mapping[str, Any]) -> dict[str, Any]:
    return check_text(live.folder, _read_text(fields, "text"))


def _save(live: LiveServer, fields: Mapping[str, Any]) -> dict[str, Any]:
    name = _read_text(fields, "name")
    save_spec(live.folder, name, _read_text(fields, "text"), fields.get("replace") is True)
    return {"saved": name}


def _plan(live: LiveServer, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Begin to plan a spec; one with mistakes is answered with them and not begun."""
    text = _read_text(fields, "text")
    checked = check_text(live.folder, text)
    if not checked["valid"]:
        return checked
    run = live.planner.start(checked["kind"], text, fields.get("quick") is True)
    return {**checked, "run": run.summarise()}


def _cancel(live: LiveServer, fields: Mapping[str, Any]) -> dict[str, Any]:
    return {"cancelled": live.planner.cancel()}


_PAGES: dict[str, Callable[[LiveServer], str | dict[str, Any]]] = {
    "": LiveServer.build_page,
    "all": _list_all,
}
_PARTS: dict[str, Callable[[LiveServer, str], str | dict[str, Any]]] = {
    "schema": _send_schema,
    "spec": _send_spec,
    "outcome": _send_outcome,
    "replay": _send_replay,
    "comparison": _send_comparison,
}
_ACTIONS: dict[str, Callable[[LiveServer, Mapping[str, Any]], dict[str, Any]]] = {
    "validate": _check,
    "save": _save,
    "plan": _plan,
    "cancel": _cancel,
}
