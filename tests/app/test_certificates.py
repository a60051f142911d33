"""Certificates of this installation: a browser that trusts the authority comes in, any other does not."""

import datetime
import ipaddress
import os
import signal
import ssl
import stat
import threading
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding
from typer.testing import CliRunner

from mrnav_server.app import certificates
from mrnav_server.app.addresses import Address, local_addresses, parsed
from mrnav_server.app.certificates import Certificates, provide
from mrnav_server.app.ready import Ready
from mrnav_server.app.serve import serve
from mrnav_server.cli.main import app
from mrnav_server.core.errors import ConfigError
from mrnav_server.settings import Settings, load_settings
from tests.app.fake_rig import SETTINGS, FakeRig

NOW = datetime.datetime.now(datetime.UTC)
NAMES: list[Address] = ["localhost", "bench.example", ipaddress.ip_address("127.0.0.1")]


def made(
    folder: Path, names: list[Address] = NAMES, days: float = 0.0, *, renew: bool = False
) -> Certificates:
    return provide(folder, names, NOW + datetime.timedelta(days=days), renew=renew)


def handshake(certificate: Path, key: Path, authority: Path, host: str) -> None:
    """Let a client that trusts an authority meet a server, without a network."""
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(certificate, key)
    up, down = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = ssl.create_default_context(cafile=str(authority)).wrap_bio(down, up, server_hostname=host)
    peer = server.wrap_bio(up, down, server_side=True)
    for _ in range(4):
        for side in (client, peer):
            try:
                side.do_handshake()
            except ssl.SSLWantReadError:
                continue


def serving(tls: Certificates, visit: Callable[[str], None]) -> None:
    """Serve with a certificate while a thread visits."""
    config = replace(
        SETTINGS.server,
        tls_certificate=str(tls.certificate),
        tls_key=str(tls.key),
        tls_authority=str(tls.authority),
    )

    def visiting(url: str) -> None:
        try:
            visit(url)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    def announce(ready: Ready) -> None:
        threading.Thread(target=visiting, args=(ready.url.partition("?")[0],)).start()

    serve(FakeRig, Settings(server=config), announce)


def test_who_trusts_the_authority_comes_in_and_nobody_else(tmp_path: Path) -> None:
    tls = made(tmp_path)
    trusting = ssl.create_default_context(cafile=str(tls.authority))
    seen: dict[str, object] = {}

    def visit(url: str) -> None:
        assert url.startswith("https://127.0.0.1:")
        for name, address, context in (
            ("page", f"{url}xr", trusting),
            ("authority", f"{url}ca.crt", trusting),
            ("stranger", url, ssl.create_default_context()),
            ("plain", url.replace("https", "http"), None),
        ):
            try:
                with urllib.request.urlopen(address, timeout=10, context=context) as answer:
                    seen[name] = answer.read()
            except (urllib.error.URLError, OSError) as error:
                seen[name] = error

    serving(tls, visit)
    assert b"<!doctype html>" in seen["page"]  # type: ignore[operator]
    assert seen["authority"] == tls.authority.read_bytes()
    assert "CERTIFICATE_VERIFY_FAILED" in str(seen["stranger"])
    assert isinstance(seen["plain"], OSError)


def test_keys_are_for_this_user_alone(tmp_path: Path) -> None:
    tls = made(tmp_path / "tls")
    modes = {file.name: stat.S_IMODE(file.stat().st_mode) for file in (tmp_path / "tls").iterdir()}
    assert modes == {"ca.crt": 0o644, "ca.key": 0o600, "server.crt": 0o644, "server.key": 0o600}
    assert stat.S_IMODE((tmp_path / "tls").stat().st_mode) == 0o700
    handshake(tls.certificate, tls.key, tls.authority, "bench.example")


def test_a_certificate_serves_until_it_is_old_and_the_authority_stays(tmp_path: Path) -> None:
    first = made(tmp_path)
    trusted = first.authority.read_bytes()
    assert first.renewed
    assert not made(tmp_path, days=300).renewed
    old = made(tmp_path, days=380)
    assert old.renewed
    assert old.until > first.until
    assert made(tmp_path, renew=True).renewed
    assert made(tmp_path, [*NAMES, ipaddress.ip_address("192.168.7.9")]).renewed
    handshake(first.certificate, first.key, first.authority, "192.168.7.9")
    assert first.authority.read_bytes() == trusted
    assert made(tmp_path, days=3300).authority.read_bytes() != trusted


def test_the_authority_vouches_for_nothing_but_this_machine(tmp_path: Path) -> None:
    tls = made(tmp_path)
    authority, key = certificates._authority(tmp_path, NAMES, NOW)
    rogue, rogue_key = tmp_path / "rogue.crt", tmp_path / "rogue.key"
    for host in ("bank.example", "8.8.8.8"):
        leaf = certificates._leaf(authority, key, parsed([host]), NOW, rogue_key)
        certificates._write(rogue, leaf.public_bytes(Encoding.PEM), 0o644)
        with pytest.raises(ssl.SSLCertVerificationError, match="permitted subtree"):
            handshake(rogue, rogue_key, tls.authority, host)
        with pytest.raises(ConfigError, match=f"may not vouch for {host}"):
            made(tmp_path, parsed([host]))


def test_files_that_do_not_belong_together_are_told(tmp_path: Path) -> None:
    made(tmp_path)
    made(tmp_path / "other")
    (tmp_path / "other" / "ca.key").replace(tmp_path / "ca.key")
    with pytest.raises(ConfigError, match=r"does not belong to .*ca.crt"):
        made(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="--folder"):
        made(tmp_path / "file")


def test_this_machine_knows_its_names() -> None:
    names = local_addresses()
    assert names[0] == "localhost"
    assert {ipaddress.ip_address("127.0.0.1"), ipaddress.ip_address("::1")} <= set(names)
    assert len(names) == len(set(names))
    assert parsed(["Bench.Example", "10.0.0.7"]) == ["bench.example", ipaddress.ip_address("10.0.0.7")]
    with pytest.raises(ConfigError, match="neither"):
        parsed(["https://bench/"])


def test_the_command_writes_settings_that_the_server_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["tls", "--folder", str(tmp_path / "tls"), "--name", "bench.example"]
    told = CliRunner().invoke(app, words)
    assert told.exit_code == 0, told.output
    assert "bench.example" in told.stdout
    assert not (tmp_path / "mrnav.toml").exists()
    again = CliRunner().invoke(app, [*words, "--save"])
    assert "still serves" in again.stdout
    server = load_settings(None, {"MRNAV_SERVER__HOST": "0.0.0.0"}).server
    for file in (server.tls_certificate, server.tls_key, server.tls_authority):
        assert Path(file or "").is_file()
    fingerprint = next(line.strip() for line in again.stdout.splitlines() if line.count(":") == 31)
    assert fingerprint in told.stdout
