"""Who is answered, over HTTP and without a browser: the user's own browser, and nobody else."""

import base64
import contextlib
import http.client
import json
import re
import socket
import zlib
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from fmuid import InputError
from fmuid.apps.workbench import Folder, Workbench, server
from tests.support import plain_page
from tests.support.workbench import PATIENCE, running

OTHER_COOKIE = "jupyter=secret-of-another-server"


class Client:
    """Speaks HTTP with a workbench as a browser, or as somebody else."""

    def __init__(self, bench: Workbench, folder: Path) -> None:
        parts = urlsplit(bench.address)
        assert parts.port is not None
        self.folder, self.port, self.token = folder, parts.port, parts.query.removeprefix("token=")
        self.own = f"127.0.0.1:{self.port}"
        status, headers, page = self.get(f"/?token={self.token}")
        assert status == 200
        assert 'content="0;url=/"' in page
        self.set_cookie = headers["Set-Cookie"]
        self.cookie = self.set_cookie.split(";")[0]

    def get(self, path: str, **headers: str) -> tuple[int, dict[str, str], str]:
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)) as connection:
            connection.putrequest("GET", path, skip_host="Host" in headers)
            for name, value in headers.items():
                connection.putheader(name.replace("_", "-"), value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read().decode(errors="replace")

    def status(self, path: str, **headers: str) -> int:
        return self.get(path, **headers)[0]

    def session(self) -> str:
        _, _, page = self.get("/study", Cookie=f"{self.cookie}; {OTHER_COOKIE}", X_Secret="of a header")
        found = re.search(r'"token": "([^"]+)"', page)
        assert found
        return found[1]

    def websocket(self, session: str, *, origin: str | None, host: str = "", cookie: str | None = "") -> str:
        """Return the status of a handshake, and whether the session began."""
        lines = [f"Host: {host or self.own}", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
        lines += [f"Sec-WebSocket-Key: {base64.b64encode(b'0' * 16).decode()}"]
        lines += [f"Sec-WebSocket-Protocol: bokeh, {session}"]
        lines += [f"Origin: {origin}"] if origin is not None else []
        lines += [f"Cookie: {self.cookie if cookie == '' else cookie}"] if cookie is not None else []
        with socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE) as wire:
            wire.sendall(("GET /study/ws HTTP/1.1\r\n" + "\r\n".join(lines) + "\r\n\r\n").encode())
            said = b""
            while b"ACK" not in said and (more := wire.recv(4096)):
                said += more
                if not said.startswith(b"HTTP/1.1 101"):
                    break
        return said.split(b" ")[1].decode() + (" ACK" if b"ACK" in said else "")


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    folder = tmp_path_factory.mktemp("open")
    (folder / "work").mkdir()
    (folder / "work/table.csv").write_text("time,i\n0,1\n")
    (folder / "work/model.fmu").write_text("no such thing")
    (folder / "work/.secret.csv").write_text("secret")
    (folder / "outside.csv").write_text("secret")
    (folder / "work/link.csv").symlink_to(folder / "outside.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(server, "_pages", lambda: {"/study": plain_page.build})
        patch.setenv("BOKEH_ALLOW_WS_ORIGIN", "*")
        with running(Workbench(Folder(folder / "work"))) as bench:
            yield Client(bench, folder / "work")


STATIC = "/static/js/bokeh.min.js"


def test_token_of_the_first_address_becomes_a_cookie(client: Client) -> None:
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= {part.strip() for part in client.set_cookie.split(";")}
    assert client.token not in client.cookie
    assert client.status("/", Cookie=client.cookie) == 200
    page = client.get(f"//evil.example/study?file=a%26b&token={client.token}")[2]
    assert 'content="0;url=/evil.example/study?file=a%26b"' in page


@pytest.mark.parametrize("path", ["/", "/study", STATIC, "/file/table.csv", "/own/style.css"])
def test_nobody_is_answered_without_the_cookie(client: Client, path: str) -> None:
    assert client.status(path) == 403
    assert client.status(path, Cookie=f"{client.cookie.split('=')[0]}=wrong") == 403
    assert client.status(f"{path}?token=wrong") == 403
    assert client.status(path, Cookie=client.cookie) == 200


def test_foreign_hosts_and_pages_are_refused(client: Client) -> None:
    evil = f"evil.example:{client.port}"
    assert client.status(f"/?token={client.token}", Host=evil) == 403
    for path, headers, status in (
        ("/", {"Host": evil}, 403),
        (STATIC, {"Host": evil}, 403),
        ("/", {"Host": "127.0.0.1"}, 403),
        ("/", {"Host": f"localhost:{client.port}"}, 200),
        ("/study/autoload.js?bokeh-autoload-element=1", {}, 403),
        ("/", {"Origin": "http://evil.example"}, 403),
        ("/file/table.csv", {"Sec_Fetch_Site": "cross-site"}, 403),
        ("/file/table.csv", {"Sec_Fetch_Site": "same-site"}, 403),
        ("/file/table.csv", {"Sec_Fetch_Site": "same-origin"}, 200),
    ):
        assert client.status(path, Cookie=client.cookie, **headers) == status, (path, headers)


def test_websockets_begin_for_the_own_page_only(client: Client) -> None:
    session, own = client.session(), f"http://{client.own}"
    assert client.websocket(session, origin=own) == "101 ACK"
    for origin in ("http://evil.example", "http://127.0.0.1:8888", "null", own.replace("http", "https")):
        assert client.websocket(session, origin=origin) == "403"
    assert client.websocket(session, origin=own, cookie=None) == "403"
    assert client.websocket(session, origin=own, cookie=OTHER_COOKIE) == "403"
    assert client.websocket(session, origin=own, host="evil.example") == "403"
    forged = base64.urlsafe_b64encode(json.dumps({"session_id": "x", "session_expiry": 9**12}).encode()).decode()
    assert client.websocket(forged.rstrip("="), origin=own) == "101"


def test_session_token_contains_nothing_of_the_browser(client: Client) -> None:
    payload = json.loads(_decoded(client.session().split(".")[0]))
    told = json.dumps(payload) + zlib.decompress(_decoded(payload.get("__bk__zlib_", ""))).decode()
    assert "secret-of-another-server" not in told
    assert client.cookie not in told
    assert client.token not in told
    assert "of a header" not in told


def _decoded(text: str) -> bytes:
    return base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))


@pytest.mark.parametrize("path", ["/", "/study", "/nowhere", "/static/js/bokeh.min.js", "/file/table.csv"])
def test_pages_cannot_be_framed(client: Client, path: str) -> None:
    _, headers, _ = client.get(path, Cookie=client.cookie)
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Frame-Options"] == "DENY"
    assert headers["Referrer-Policy"] == "no-referrer"
    scripts = re.search(r"script-src ([^;]*)", headers["Content-Security-Policy"])
    assert (scripts[1] == "'self'") if scripts else path.startswith("/file/")


def test_only_files_of_the_folder_are_served(client: Client) -> None:
    assert client.get("/file/table.csv", Cookie=client.cookie)[2] == "time,i\n0,1\n"
    wrong = ["../outside.csv", "..%2Foutside.csv", "%2e%2e/outside.csv", "link.csv", ".secret.csv", "model.fmu", "%00"]
    for name in (*wrong, str(client.folder.parent / "outside.csv"), "/etc/passwd", ""):
        assert client.status(f"/file/{name}", Cookie=client.cookie) == 404, name


def test_folder_refuses_what_is_outside(tmp_path: Path) -> None:
    for name, said in (("nowhere", "folder not found"), (".", r"'\.\.' is not in")):
        with pytest.raises(InputError, match=said):
            Folder(tmp_path / name).path("..")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Tornado leaves a socket open
def test_port_in_use_is_refused(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match=r"cannot be used .*Give a free --port"):
            Workbench(Folder(tmp_path), port=taken.getsockname()[1])
