"""The certificate that phones see: made once, used again, renewed when it does not do any more."""

import os
import signal
import socket
import ssl
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
from cryptography import x509

from rholoc.errors import InvalidInput
from rholoc.service.operate import certificates
from rholoc.service.operate.certificates import addresses, server_certificate

NAMES = ("127.0.0.1", "::1", "localhost", "phone-server.local")


def certificate_in(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def test_a_certificate_is_made_once_and_used_again(tmp_path: Path) -> None:
    first = server_certificate(tmp_path, NAMES)
    kept = first.path.read_bytes()
    assert server_certificate(tmp_path, NAMES[:2]) == first
    assert first.path.read_bytes() == kept
    assert first.path.stat().st_mode & 0o077 == 0
    assert (tmp_path / "tls" / "authority.key").stat().st_mode & 0o077 == 0


def test_a_further_name_renews_it_under_the_same_authority(tmp_path: Path) -> None:
    before = certificate_in(server_certificate(tmp_path, NAMES).path)
    authority = (tmp_path / "tls" / "authority.pem").read_bytes()
    after = server_certificate(tmp_path, (*NAMES, "10.1.2.3"))
    assert after.authority.read_bytes() == authority
    assert certificate_in(after.path).serial_number != before.serial_number
    certificate_in(after.path).verify_directly_issued_by(certificate_in(after.authority))


def test_it_lives_no_longer_than_browsers_allow_and_is_renewed_in_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = certificate_in(server_certificate(tmp_path, NAMES).path)
    assert timedelta(days=300) < made.not_valid_after_utc - made.not_valid_before_utc <= timedelta(days=398)
    monkeypatch.setattr(certificates, "_RENEWED_BEFORE", made.not_valid_after_utc - datetime.now(UTC))
    assert certificate_in(server_certificate(tmp_path, NAMES).path).serial_number != made.serial_number


@pytest.mark.parametrize("name", ["server.pem", "authority.pem", "authority.key"])
def test_a_damaged_file_is_reported(tmp_path: Path, name: str) -> None:
    server_certificate(tmp_path, NAMES)
    (tmp_path / "tls" / name).write_bytes(b"-----BEGIN CERTIFICATE-----\nnone\n")
    with pytest.raises(InvalidInput, match="damaged"):
        server_certificate(tmp_path, NAMES)


def test_addresses_are_others_ways_here() -> None:
    for address in addresses():
        assert not address.startswith("127.")
        socket.getaddrinfo(address, None, flags=socket.AI_NUMERICHOST)


def test_serve_tls_answers_over_https_and_shows_where_to_record(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "rholoc", "serve", "--tls", "--no-worker", "--host", "127.0.0.1"]
    command += ["--port", str(port), "--maps", str(tmp_path / "maps"), "--data", str(tmp_path / "data")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert f"https://127.0.0.1:{port}/record" in process.stderr.readline()
        process.stderr.readline()
        assert f"https://127.0.0.1:{port}" in process.stderr.readline()  # it listens, and takes calls from here on
        trusted = ssl.create_default_context(cafile=tmp_path / "data" / "tls" / "authority.pem")
        with httpx.Client(verify=trusted, transport=httpx.HTTPTransport(verify=trusted, retries=5)) as client:
            assert client.get(f"https://127.0.0.1:{port}/healthz", timeout=30).is_success
            assert client.get(f"https://127.0.0.1:{port}/record").headers["content-type"].startswith("text/html")
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(30)
