"""``mrnav stop``: the controller at once, then every server of this user on this machine."""

import json
import os
import ssl
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from mrnav_server.cli.serve import ConfigOption
from mrnav_server.client.rest import Rest, RestError

if TYPE_CHECKING:
    from mrnav_server.settings import Settings

_ANSWER_S = 2.0


@dataclass(frozen=True, slots=True)
class Stopped:
    """What one STOP came to.

    Attributes:
        what: Who was told.
        ok: Whether it answered.
        found: What it answered, or what to do.
    """

    what: str
    ok: bool
    found: str


def stop(
    config: ConfigOption = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Stop the manipulator now: the controller that the settings name, and every server on this machine.

    It is no emergency stop: that is the power switch of the controller.
    """
    from mrnav_server.app.ready import running_servers
    from mrnav_server.settings import load_settings

    done = _stop_controllers(load_settings(config, os.environ))
    done += [_stop_server(server.port, server.url, server.viewer_token) for server in running_servers()]
    if not done:
        done = [Stopped("servers", ok=False, found="none runs on this machine")]
    stopped = any(each.ok for each in done)
    if json_output:
        typer.echo(json.dumps({"ok": stopped, "stopped": [asdict(each) for each in done]}))
    else:
        page = Console(highlight=False, soft_wrap=True)
        for each in done:
            page.print(
                f"{'[green]stopped[/]' if each.ok else '[bold red]no answer[/]'} {each.what}: {each.found}"
            )
        if not stopped:
            page.print("[bold red]Nothing answered: switch the controller off.[/]")
    raise typer.Exit(0 if stopped else 1)


def _stop_controllers(settings: "Settings") -> list[Stopped]:
    """Send STOP straight to the controller until its tip rests; needs no server."""
    if not settings.manipulator.driver.startswith("sensapex"):
        return []
    from mrnav_server.devices.sensapex.raw_stop import RawStop
    from mrnav_server.devices.sensapex.stop_until_rest import Tip, stop_until_rest

    sensapex = settings.sensapex
    paths = [RawStop(address, sensapex.port, sensapex.wire_id) for address in sensapex.addresses]
    for path in paths:
        path.send()
    done = []
    for path in paths:
        stops, position_um, rested = stop_until_rest(path, Tip(path.target, sensapex.wire_id))
        where = f"controller at {path.target[0]}"
        if position_um is None:
            done.append(Stopped(where, ok=False, found=f"{stops} STOPs sent, it tells no position"))
        else:
            at = ", ".join(f"{axis_um:.0f}" for axis_um in position_um)
            found = f"rests at {at} µm" if rested else f"still moves at {at} µm: switch it off"
            done.append(Stopped(where, ok=rested, found=found))
        path.close()
    return done


def _stop_server(port: int, url: str, token: str) -> Stopped:
    what = f"server on port {port}"
    try:
        rest = Rest(url.partition("/?")[0], token, timeout_s=_ANSWER_S, context=_unchecked())
        rest.post("/api/v1/mode", {"ask": "stop"})
    except RestError as error:
        return Stopped(what, ok=False, found=str(error))
    return Stopped(what, ok=True, found="its rig says STOP, until reset")


def _unchecked() -> ssl.SSLContext:
    """Accept any certificate: the server is on this machine, and the token is a viewer's."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context
