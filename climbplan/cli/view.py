"""`climbplan view`: a plan in the browser, in three dimensions."""

from __future__ import annotations

import importlib.util
import webbrowser
from typing import Annotated

import typer

from climbplan.api.plan_path import find_plan
from climbplan.cli.console import Invocation, print_result
from climbplan.cli.interrupts import interrupt_handled
from climbplan.cli.options import Plan, Quiet, Verbose
from climbplan.errors import UsageError


def view(
    context: typer.Context,
    plan: Plan,
    *,
    port: Annotated[
        int,
        typer.Option(
            "--port", metavar="N", min=0, max=65535, help="Port of the page; 0 takes a free one."
        ),
    ] = 8080,
    host: Annotated[
        str,
        typer.Option(
            "--host", metavar="ADDRESS", help="Address to serve at; 0.0.0.0 admits other machines."
        ),
    ] = "127.0.0.1",
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Whether a browser is opened.")
    ] = True,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Show a plan in 3-D: time slider, forces, friction cones, torque colours, terrain.

    Prints the page's address and serves it until Ctrl-C. If the port is taken, the next free one
    is. Needs `pip install 'climbplan[view]'`.
    """
    path = find_plan(plan)
    if importlib.util.find_spec("viser") is None:
        raise UsageError("`view` needs viser: pip install 'climbplan[view]'")
    from climbplan.api.kinds import identify_kind
    from climbplan.cli.unsound import warn_of_failure

    kind = identify_kind(path)
    warn_of_failure(kind, path)
    scene = kind.read_scene(path)
    from climbplan.reports.viewer.server import Viewer

    with Viewer(scene, host, port) as viewer:
        print_result(viewer.address)
        context.ensure_object(Invocation).note("Ctrl-C ends it")
        if browser:
            webbrowser.open(viewer.address)
        try:
            viewer.run()
        except KeyboardInterrupt as stop:
            if type(stop) is not KeyboardInterrupt:
                raise  # SIGTERM, which has an exit code of its own
            interrupt_handled()
