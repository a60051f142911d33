"""``mrnav tls``: a certificate for this machine, so that headsets may open its pages."""

import datetime
from pathlib import Path
from typing import Annotated

import platformdirs
import typer
from rich.console import Console

from mrnav_server.cli.serve import ConfigOption


def tls(
    config: ConfigOption = None,
    name: Annotated[
        list[str] | None, typer.Option("--name", help="One more name or address of this machine; repeatable.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Where keys and certificates lie; by default with the user's data.")
    ] = None,
    renew: Annotated[
        bool, typer.Option("--renew", help="Make the certificate anew, whatever its age.")
    ] = False,
    save: Annotated[
        bool, typer.Option("--save", help="Write the settings into ./mrnav.toml, or the file of --config.")
    ] = False,
) -> None:
    """Make a certificate authority of this installation and a certificate for this machine; again renews it.

    WebXR and the safe use of tokens from other machines need https.
    """
    from mrnav_server.app.addresses import local_addresses, parsed
    from mrnav_server.app.certificates import provide
    from mrnav_server.cli.settings_file import store
    from mrnav_server.settings import DEFAULT_FILE

    names = list(dict.fromkeys([*local_addresses(), *parsed(name or [])]))
    place = (folder or Path(platformdirs.user_data_dir("mrnav")) / "tls").absolute()
    made = provide(place, names, datetime.datetime.now(datetime.UTC), renew=renew)
    settings = {
        "tls_certificate": str(made.certificate),
        "tls_key": str(made.key),
        "tls_authority": str(made.authority),
    }
    say = Console(soft_wrap=True, highlight=False, markup=False, emoji=False).print
    say(f"{'New certificate' if made.renewed else 'The certificate still serves'}, until {made.until}, for")
    say(f"  {', '.join(made.names)}")
    if save:
        file = config or DEFAULT_FILE
        store(file, "server", settings)
        say(f"{file} names it: start the server with `mrnav serve`.")
    else:
        say("Settings (--save writes them):\n  [server]")
        for key, value in settings.items():
            say(f'  {key} = "{value}"')
    say('Set server.host = "0.0.0.0" to let other machines in; they open https://ADDRESS:PORT/ with one')
    say('of these addresses; to open it by a name, put that into server.origins: ["https://NAME:PORT"].')
    say(f"What they are to trust: https://ADDRESS:PORT/ca.crt, or the file {made.authority}. Its SHA-256 is")
    say(f"  {made.fingerprint}")
