"""``mrnav serve``: the rig, its server and its pages."""

import logging
import os
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

if TYPE_CHECKING:
    from mrnav_server.app.ready import Ready

ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="TOML file with settings; ./mrnav.toml if there is one.")
]


def serve(
    config: ConfigOption = None,
    ready_file: Annotated[
        Path | None, typer.Option(help="File that gets addresses and tokens as JSON once the rig is ready.")
    ] = None,
    study: Annotated[
        Path | None, typer.Option(help="Study to lead through; its next step chooses the vessel model.")
    ] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Open the dashboard in a browser.")] = False,
) -> None:
    """Start the rig and its server; Ctrl-C stops both.

    Any setting can also come from a variable: MRNAV_SERVER__PORT=8100 is port in section server.
    """
    from mrnav_server.app.rig import Rig
    from mrnav_server.app.serve import serve as run_server
    from mrnav_server.cli.study_lead import led_study, variables
    from mrnav_server.settings import load_settings

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    led = led_study(study) if study is not None else None
    settings = load_settings(config, {**os.environ, **(variables(led) if led else {})})
    simulated = settings.manipulator.driver == settings.rig.camera == "simulated"

    def announce(ready: "Ready") -> None:
        console = Console(soft_wrap=True, highlight=False)
        console.print(f"{'Simulated rig' if simulated else 'Rig'} ready. Open [bold]{ready.url}[/]")
        console.print(f"Headset: TCP port {ready.hand_port}. Ctrl-C stops.")
        if open_page:
            webbrowser.open(ready.url)

    run_server(Rig, settings, announce, ready_file, led)
