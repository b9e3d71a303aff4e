"""`climbplan serve`: the live page, where specs are written, planned and compared."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from climbplan.cli.console import Invocation, print_result
from climbplan.cli.interrupts import interrupt_handled
from climbplan.cli.options import Quiet, Verbose


def serve(
    context: typer.Context,
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Directory of specs: paths in specs start there, and plans appear in its "
            "outputs/ [default: the current one].",
        ),
    ] = Path(),
    *,
    port: Annotated[
        int,
        typer.Option(
            "--port", metavar="N", min=0, max=65535, help="Port of the page; 0 takes a free one."
        ),
    ] = 8090,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Whether a browser is opened.")
    ] = True,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Serve a page to write specs, plan them with progress, replay, check and compare plans.

    Prints the page's address, which contains a token, and serves it to this machine alone until
    Ctrl-C. If the port is taken, the next free one is. Needs no network.
    """
    from climbplan.live.server import LiveServer

    with LiveServer(folder, port) as live:
        print_result(live.address)
        context.ensure_object(Invocation).note("Ctrl-C ends it")
        if browser:
            webbrowser.open(live.address)
        try:
            live.run()
        except KeyboardInterrupt as stop:
            if type(stop) is not KeyboardInterrupt:
                raise  # SIGTERM, which has an exit code of its own
            interrupt_handled()
