"""The workbench by TLS: with a certificate that a test makes, over HTTPS and its websocket."""

from __future__ import annotations

import http.client
import re
import shutil
import ssl
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from fmuid.apps.workbench import LOCAL, Certificate, Folder, Workbench

OPENSSL = shutil.which("openssl")
PATIENCE = 60.0


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Certificate:
    if OPENSSL is None:
        pytest.skip("there is no openssl")
    folder = tmp_path_factory.mktemp("tls")
    key, chain = folder / "key.pem", folder / "chain.pem"
    words = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=bench"]
    words += ["-addext", f"subjectAltName=IP:{LOCAL}", "-keyout", str(key), "-out", str(chain)]
    subprocess.run([OPENSSL, *words], check=True, capture_output=True)
    return Certificate(chain, key)


@pytest.fixture(scope="module")
def bench(certificate: Certificate, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workbench]:
    found, ready = Workbench(Folder(tmp_path_factory.mktemp("work")), certificate=certificate), threading.Event()
    thread = threading.Thread(target=found.run, args=(ready.set,))
    thread.start()
    assert ready.wait(PATIENCE)
    yield found
    found.stop()
    thread.join(PATIENCE)


def get(bench: Workbench, trusted: Path | None, path: str, **headers: str) -> tuple[int, dict[str, str], str]:
    port = urlsplit(bench.address).port
    assert port is not None
    context = ssl.create_default_context(cafile=trusted)
    connection = http.client.HTTPSConnection(LOCAL, port, timeout=PATIENCE, context=context)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read().decode()
    finally:
        connection.close()


def test_pages_are_given_by_tls_to_who_has_the_secret(bench: Workbench, certificate: Certificate) -> None:
    assert bench.address.startswith(f"https://{LOCAL}:")
    token = urlsplit(bench.address).query
    assert get(bench, certificate.chain, "/")[0] == 403
    status, headers, _ = get(bench, certificate.chain, f"/?{token}")
    assert status == 200
    given = headers["Set-Cookie"]
    assert {"Secure", "HttpOnly", "SameSite=Strict"} <= {part.strip() for part in given.split(";")}
    status, headers, page = get(bench, certificate.chain, "/", Cookie=given.split(";")[0])
    assert status == 200
    assert "There is no study here yet" in page
    assert headers["Strict-Transport-Security"].startswith("max-age=")
    sockets = re.search(r"connect-src 'self' ([^;]*)", headers["Content-Security-Policy"])
    assert sockets is not None
    assert all(each.startswith("wss://") for each in sockets[1].split())
    own = bench.address.split("/?")[0]
    assert get(bench, certificate.chain, "/", Cookie=given.split(";")[0], Origin=own)[0] == 200
    assert get(bench, certificate.chain, "/", Cookie=given.split(";")[0], Origin=own.replace("https", "http"))[0] == 403


def test_who_does_not_trust_the_certificate_sends_nothing(bench: Workbench) -> None:
    with pytest.raises(ssl.SSLCertVerificationError):
        get(bench, None, "/")


def test_plain_http_is_not_answered(bench: Workbench) -> None:
    port = urlsplit(bench.address).port
    assert port is not None
    connection = http.client.HTTPConnection(LOCAL, port, timeout=PATIENCE)
    connection.request("GET", "/")
    with pytest.raises((http.client.HTTPException, ConnectionError)):
        connection.getresponse()
    connection.close()
