"""The viewer's server: a time slider, a player and switches beside the scene."""

from __future__ import annotations

import contextlib
import errno
import html
import io
import socket
import threading
import time as clock
from types import TracebackType
from typing import Any, Self

import numpy as np
import viser

from climbplan.errors import UsageError
from climbplan.reports.viewer.origins import restrict_to_own_origins
from climbplan.reports.viewer.scene import ViewerScene
from climbplan.reports.viewer.stage import SceneHandles

_RATE = 30.0  # [1/s] of frames while playing
_TRIES = 50  # ports
_SPEEDS = {"0.1": 0.1, "0.25": 0.25, "0.5": 0.5, "1": 1.0, "2": 2.0, "5": 5.0, "10": 10.0}
_SWITCHES = {
    "Terrain": "terrain",
    "Friction labels": "labels",
    "Paths": "paths",
    "Forces": "forces",
    "Friction cones": "cones",
}


def _format_html(*lines: str) -> str:
    """Return lines of plain text."""
    texts = "<br>".join(html.escape(line) for line in lines)
    return f'<div style="padding: 0 0.75em 0.5em; font-size: 0.875em">{texts}</div>'


def _find_free_port(host: str, port: int) -> int:
    """Return the first port from `port` on that is free; for 0 any.

    The server's own thread would die of an address that cannot be had and leave us waiting.
    """
    for candidate_port in [port] if port == 0 else range(port, min(port + _TRIES, 65536)):
        try:
            with socket.create_server((host, candidate_port)) as server_socket:
                return int(server_socket.getsockname()[1])
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise UsageError(
                    f"--host {host} --port {candidate_port}: {error.strerror}"
                ) from None
    raise UsageError(f"--port {port}: taken, as are the {_TRIES} after it")


class Viewer:
    """A scene on a local port until it is closed.

    host: address to listen on, "127.0.0.1" for this machine only; port: the first one to try, 0
    for any.

    Raises:
        UsageError: the address or all ports cannot be had.
    """

    def __init__(self, scene: ViewerScene, host: str, port: int) -> None:
        self._scene = scene
        free = _find_free_port(host, port)
        # The library greets on standard output, which is for results.
        with contextlib.redirect_stdout(io.StringIO()), restrict_to_own_origins(host):
            self._server = viser.ViserServer(host, free, label=scene.title, verbose=False)
        self.host, self.port = host, self._server.get_port()
        self._lock = threading.Lock()  # switches answer in threads of the server
        self._stage = SceneHandles(self._server, scene)
        self._add_controls()
        self._show(float(scene.time[0]))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    @property
    def address(self) -> str:
        """Return where a browser finds it."""
        name = "localhost" if self.host in ("127.0.0.1", "0.0.0.0", "::1", "::") else self.host
        return f"http://{name}:{self.port}"

    def run(self) -> None:
        """Play while the player is on, until the process is interrupted."""
        last = clock.monotonic()
        while True:
            clock.sleep(1 / _RATE)
            now = clock.monotonic()
            if self._play.value:
                self._advance((now - last) * _SPEEDS[self._speed.value])
            last = now

    def _add_controls(self) -> None:
        gui: Any = self._server.gui  # its decorators are untyped
        scene = self._scene
        gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        first, last = float(scene.time[0]), float(scene.time[-1])
        # Texts come from files: as markdown they could run code in the page.
        gui.add_html(_format_html(*scene.facts))
        self._time = gui.add_slider(
            "Time [s]", first, max(last, first + 1e-3), max((last - first) / 2000, 1e-3), first
        )
        self._caption = gui.add_html(_format_html(scene.caption[0]))
        self._play = gui.add_checkbox("Play", initial_value=False)
        self._speed = gui.add_dropdown("Speed", tuple(_SPEEDS), initial_value="1")
        step = gui.add_button_group("Step", ("first", "back", "next", "last"))
        with gui.add_folder("Show"):
            for label, group in _SWITCHES.items():
                if self._stage.has(group):
                    self._add_switch(gui, label, group)
            if any(
                moving_parts and moving_parts.load is not None
                for moving_parts in (scene.rods, scene.solids)
            ):
                loads = gui.add_checkbox(
                    "Torque colours",
                    initial_value=False,
                    hint="share of each motor's limit: green 0, yellow half, red all of it",
                )
                loads.on_update(lambda _: self._color_loads(loads.value))
        self._time.on_update(lambda _: self._show(self._time.value))
        step.on_click(lambda _: self._go(step.value))

    def _add_switch(self, gui: Any, label: str, what: str) -> None:
        switch = gui.add_checkbox(label, initial_value=True)
        switch.on_update(lambda _: self._switch(what, switch.value))

    def _switch(self, what: str, visible: bool) -> None:
        with self._lock:
            self._stage.switch(what, visible)

    def _color_loads(self, on: bool) -> None:
        self._stage.show_loads = on
        self._show(self._time.value)

    def _go(self, which: str) -> None:
        self._time.value = self._stop(which)
        self._show(self._time.value)

    def _stop(self, which: str) -> float:
        """Return the time [s] of the mark that a button asks for."""
        stops = np.concatenate([self._scene.time[:1], self._scene.time[self._scene.marks]])
        now = float(self._time.value)
        slack = 1e-3
        later, earlier = stops[stops > now + slack], stops[stops < now - slack]
        ends = (float(self._scene.time[0]), float(self._scene.time[-1]))
        if which == "next":
            return float(later[0]) if len(later) else ends[1]
        if which == "back":
            return float(earlier[-1]) if len(earlier) else ends[0]
        return ends[0] if which == "first" else ends[1]

    def _advance(self, seconds: float) -> None:
        first, last = float(self._scene.time[0]), float(self._scene.time[-1])
        later = float(self._time.value) + seconds
        self._time.value = first if later > last else later

    def _show(self, moment: float) -> None:
        with self._lock:
            caption = _format_html(self._stage.draw(moment))
            if self._caption.content != caption:
                self._caption.content = caption
