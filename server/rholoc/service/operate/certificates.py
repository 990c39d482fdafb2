"""HTTPS without a domain: a certificate for this machine's addresses, signed by our own authority.

Browsers give camera and motion sensors to pages over HTTPS only. The authority is created once and kept, so that a
phone that trusts it also trusts later certificates, whatever address the machine then has.
"""

import ipaddress
import socket
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import trustme
from cryptography import x509

from rholoc.disk import replace_file
from rholoc.errors import InvalidInput

_FOLDER = "tls"
_LIFETIME = timedelta(days=397)  # browsers refuse certificates that live much longer
_RENEWED_BEFORE = timedelta(days=30)
_CLOCK_DIFFERENCE = timedelta(days=1)  # for phones whose clock is behind
_ORGANIZATION = "rholoc"
_PROBED_ADDRESSES = (
    ("192.0.2.1", socket.AF_INET),
    ("2001:db8::1", socket.AF_INET6),
)  # documentation addresses: routable, but unused


@dataclass(frozen=True)
class Certificate:
    """PEM files.

    Attributes:
        path: the server's certificate and its private key.
        authority: the authority's certificate, for phones to trust.
    """

    path: Path
    authority: Path


def addresses() -> tuple[str, ...]:
    """Addresses under which other devices may reach this machine, the likeliest first, none local; sends nothing."""
    found: list[str] = []
    for target, family in _PROBED_ADDRESSES:
        with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((target, 9))
            found.append(probe.getsockname()[0])
    with suppress(OSError):
        found += [str(info[4][0]) for info in socket.getaddrinfo(socket.gethostname(), None)]
    return tuple(dict.fromkeys(one for one in found if _is_reachable(one)))


def server_certificate(data_dir: Path, names: tuple[str, ...]) -> Certificate:
    """A certificate for ``names``, host names and addresses, and its authority's, stored in ``data_dir``.

    Issued anew, by the stored authority, if the stored one lacks a name or expires within 30 days.

    Raises:
        InvalidInput: the stored files are damaged.
        StorageFull: the disk is full.
    """
    folder = Path(data_dir) / _FOLDER
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    kept = Certificate(folder / "server.pem", folder / "authority.pem")
    try:
        authority = _authority(kept.authority, folder / "authority.key")
        if not (kept.path.is_file() and _serves(kept.path.read_bytes(), names)):
            _issue(authority, kept.path, names)
    except ValueError as error:
        raise InvalidInput(
            f"The certificates in {folder} are damaged.", "Remove the folder; new ones are made."
        ) from error
    return kept


def _authority(certificate: Path, key: Path) -> trustme.CA:
    """The stored authority, made if a file is missing: its certificate and its private key. Raises ValueError."""
    if not (certificate.is_file() and key.is_file()):
        made = trustme.CA(path_length=0, organization_name=_ORGANIZATION, organization_unit_name=socket.gethostname())
        _write_secret(key, made.private_key_pem.bytes())
        replace_file(certificate, made.cert_pem.bytes())
    return trustme.CA.from_pem(certificate.read_bytes(), key.read_bytes())


def _issue(authority: trustme.CA, path: Path, names: tuple[str, ...]) -> None:
    """Write a new certificate for ``names``, with its private key and chain, to ``path``."""
    now = datetime.now(UTC)
    issued = authority.issue_cert(
        *names, organization_name=_ORGANIZATION, not_before=now - _CLOCK_DIFFERENCE, not_after=now + _LIFETIME
    )
    _write_secret(path, issued.private_key_and_cert_chain_pem.bytes())


def _serves(pem: bytes, names: tuple[str, ...]) -> bool:
    """Whether a certificate covers the names, and does not expire within 30 days."""
    certificate = x509.load_pem_x509_certificate(pem)
    subject = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    covered = set(subject.get_values_for_type(x509.DNSName))
    covered |= {str(address) for address in subject.get_values_for_type(x509.IPAddress)}
    return covered >= set(names) and certificate.not_valid_after_utc - datetime.now(UTC) > _RENEWED_BEFORE


def _write_secret(path: Path, data: bytes) -> None:
    """Write a file that only its owner may read."""
    replace_file(path, data)
    path.chmod(0o600)


def _is_reachable(address: str) -> bool:
    """Whether an address is neither loopback, link-local nor unspecified."""
    ip = ipaddress.ip_address(address.partition("%")[0])
    return not (ip.is_loopback or ip.is_link_local or ip.is_unspecified)
