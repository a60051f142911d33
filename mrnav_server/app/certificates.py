"""A certificate authority of this installation, and a certificate for this machine's addresses.

Needs the extra ``tls``. No key leaves the folder, and the authority can vouch for nothing but this machine
and private networks: a headset that trusts it trusts it with nothing else.
"""

import datetime
import ipaddress
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from mrnav_server.app.addresses import Address
from mrnav_server.core.errors import ConfigError

_AUTHORITY_DAYS = 3650
_LEAF_DAYS = 397
"""Browsers refuse certificates that are valid for longer."""
_EARLY_DAYS = 30
_PRIVATE = (
    "10.0.0.0/8",
    "172.16.0.0/12",
    "192.168.0.0/16",
    "169.254.0.0/16",
    "127.0.0.0/8",
    "::1/128",
    "fc00::/7",
)
_PRIVATE_NAMES = ("localhost", "local")


@dataclass(frozen=True, slots=True)
class Certificates:
    """Where they lie, and what they say.

    Attributes:
        authority: What a headset or a browser is told to trust.
        certificate, key: For ``server.tls_certificate`` and ``server.tls_key``.
        names: Names and addresses that the certificate vouches for.
        until: Its last day.
        fingerprint: SHA-256 of the authority, as browsers show it.
        renewed: Whether the certificate was made just now.
    """

    authority: Path
    certificate: Path
    key: Path
    names: tuple[str, ...]
    until: datetime.date
    fingerprint: str
    renewed: bool


def provide(folder: Path, names: Sequence[Address], now: datetime.datetime, *, renew: bool) -> Certificates:
    """Make the authority if there is none, and the certificate if it is missing, old or for other names.

    Args:
        folder: Is made, readable for this user alone.
        names: Names and addresses under which clients open the server.
        now: With a time zone.
        renew: Make the certificate anew in any case.

    Raises:
        ConfigError: If the folder cannot be used, or the authority may not vouch for one of the names.
    """
    authority_file, leaf_file, key_file = (folder / name for name in ("ca.crt", "server.crt", "server.key"))
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        authority, authority_key = _authority(folder, names, now)
        leaf = None if renew else _read(leaf_file)
        if leaf is None or not key_file.is_file() or not _serves(leaf, authority, names, now):
            leaf, renewed = _leaf(authority, authority_key, names, now, key_file), True
            _write(leaf_file, leaf.public_bytes(serialization.Encoding.PEM), 0o644)
        else:
            renewed = False
    except OSError as error:
        raise ConfigError(
            f"{folder} cannot be used ({error.strerror}): choose another with --folder"
        ) from None
    digest = authority.fingerprint(hashes.SHA256()).hex(":").upper()
    until = leaf.not_valid_after_utc.date()
    told = tuple(str(name) for name in names)
    return Certificates(authority_file, leaf_file, key_file, told, until, digest, renewed)


def _authority(
    folder: Path, names: Sequence[Address], now: datetime.datetime
) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """Return the authority and its key; one that ends before the next certificate would is made anew."""
    certificate_file, key_file = folder / "ca.crt", folder / "ca.key"
    authority = _read(certificate_file)
    ends = now + datetime.timedelta(days=_LEAF_DAYS)
    if authority is None or not key_file.is_file() or authority.not_valid_after_utc < ends:
        key = _new_key(key_file)
        authority = _self_signed(key, names, now)
        _write(certificate_file, authority.public_bytes(serialization.Encoding.PEM), 0o644)
        return authority, key
    loaded = serialization.load_pem_private_key(key_file.read_bytes(), None)
    if not isinstance(loaded, ec.EllipticCurvePrivateKey) or loaded.public_key() != authority.public_key():
        raise ConfigError(f"{key_file} does not belong to {certificate_file}: remove both and run this again")
    for name in names:
        if not _permits(authority, name):
            raise ConfigError(
                f"the authority in {folder} may not vouch for {name}: remove {certificate_file.name} and "
                f"{key_file.name} there, run this again, and let the headset trust the new one"
            )
    return authority, loaded


def _self_signed(
    key: ec.EllipticCurvePrivateKey, names: Sequence[Address], now: datetime.datetime
) -> x509.Certificate:
    own = [name for name in names if isinstance(name, str)]
    networks = [ipaddress.ip_network(name) for name in names if not isinstance(name, str)]
    permitted: list[x509.GeneralName] = [
        x509.DNSName(name) for name in dict.fromkeys((*_PRIVATE_NAMES, *own))
    ]
    private = [ipaddress.ip_network(text) for text in _PRIVATE]
    permitted += [x509.IPAddress(network) for network in dict.fromkeys((*private, *networks))]
    # A second authority of the same name, with another key, would not be told apart from the first.
    title = x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, "mrnav-server"),
            x509.NameAttribute(NameOID.COMMON_NAME, f"mrnav rig {now:%Y-%m-%d %H:%M:%S}"),
        ]
    )
    return (
        _builder(title, title, key.public_key(), now, _AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
        .add_extension(x509.NameConstraints(permitted, None), critical=True)
        .sign(key, hashes.SHA256())
    )


def _leaf(
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    names: Sequence[Address],
    now: datetime.datetime,
    key_file: Path,
) -> x509.Certificate:
    key = _new_key(key_file)
    title = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, str(names[0])[:64])])
    issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key())
    return (
        _builder(title, authority.subject, key.public_key(), now, _LEAF_DAYS)
        .add_extension(x509.SubjectAlternativeName([_general(name) for name in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(issuer, critical=False)
        .sign(authority_key, hashes.SHA256())
    )


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePublicKey,
    now: datetime.datetime,
    days: int,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        # A headset's clock may be a little late.
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _serves(
    leaf: x509.Certificate, authority: x509.Certificate, names: Sequence[Address], now: datetime.datetime
) -> bool:
    """Tell whether a certificate is the authority's, lasts a while, and is for these names."""
    try:
        leaf.verify_directly_issued_by(authority)
    except (InvalidSignature, ValueError):
        return False
    told = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    fresh = leaf.not_valid_after_utc > now + datetime.timedelta(days=_EARLY_DAYS)
    return fresh and {_general(name) for name in names} == set(told)


def _permits(authority: x509.Certificate, name: Address) -> bool:
    permitted = (
        authority.extensions.get_extension_for_class(x509.NameConstraints).value.permitted_subtrees or []
    )
    for tree in permitted:
        if isinstance(name, str) and isinstance(tree, x509.DNSName):
            if name == tree.value or name.endswith(f".{tree.value}"):
                return True
        elif not isinstance(name, str) and isinstance(tree, x509.IPAddress):
            network = tree.value
            if isinstance(network, ipaddress.IPv4Network | ipaddress.IPv6Network) and name in network:
                return True
    return False


def _general(name: Address) -> x509.GeneralName:
    return x509.DNSName(name) if isinstance(name, str) else x509.IPAddress(name)


def _new_key(file: Path) -> ec.EllipticCurvePrivateKey:
    key = ec.generate_private_key(ec.SECP256R1())
    pem = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    _write(file, pem, 0o600)
    return key


def _read(file: Path) -> x509.Certificate | None:
    """Return a certificate; None if there is none, or none that can be read."""
    try:
        return x509.load_pem_x509_certificate(file.read_bytes())
    except (FileNotFoundError, ValueError):
        return None


def _write(file: Path, content: bytes, mode: int) -> None:
    """Write a file that appears whole, and is never readable for more people than it shall be."""
    draft = file.with_name(f".{file.name}.{os.getpid()}")
    draft.unlink(missing_ok=True)
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as out:
        out.write(content)
    draft.replace(file)
