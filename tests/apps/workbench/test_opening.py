"""How a browser is let in: no secret on a command line, a token that is valid once, a browser in the foreground."""

import html
import http.client
import re
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from fmuid.apps.cli.options import DONE
from fmuid.apps.cli.studies import workbench
from fmuid.apps.workbench import Folder, Workbench, entry_file, server, start_browser
from tests.support import plain_page
from tests.support.isolated import wait_until
from tests.support.workbench import PATIENCE, running

# A browser in the foreground: it keeps what it was given, and goes on until it is told to end.
BROWSER = """
import pathlib, shutil, sys, time
from urllib.parse import urlsplit
from urllib.request import url2pathname
place = pathlib.Path(sys.argv[1])
shutil.copy(url2pathname(urlsplit(sys.argv[2]).path), place / "draft")
(place / "draft").replace(place / "opened")
while not (place / "end").exists():
    time.sleep(0.01)
"""


@pytest.fixture(autouse=True)
def browser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a script the user's browser; return the folder that it writes to."""
    (tmp_path / "work").mkdir()
    (tmp_path / "browser.py").write_text(BROWSER)
    monkeypatch.setenv("BROWSER", f"{sys.executable} {tmp_path / 'browser.py'} {tmp_path} %s")
    monkeypatch.setattr(webbrowser, "_tryorder", None)
    monkeypatch.setattr(webbrowser, "_browsers", {})
    return tmp_path


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Workbench]:
    monkeypatch.setattr(server, "_pages", lambda: {"/study": plain_page.build})
    with running(Workbench(Folder(tmp_path / "work"))) as found:
        yield found


def get(address: str, **headers: str) -> tuple[int, http.client.HTTPMessage]:
    parts = urlsplit(address)
    with closing(http.client.HTTPConnection(parts.netloc, timeout=PATIENCE)) as connection:
        connection.request("GET", f"{parts.path}?{parts.query}", headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers


def led_to(page: str) -> str:
    found = re.search('content="0;url=([^"]*)"', page)
    assert found is not None
    return html.unescape(found[1])


def command_lines() -> str:
    """Return the command lines of all processes of this machine, as every user reads them."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # it has ended meanwhile
            found.append(path.read_text(errors="replace"))
    return "\n".join(found)


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="command lines are not in /proc here")
def test_start_browser_shows_no_token_and_does_not_block(bench: Workbench, browser: Path) -> None:
    with entry_file(bench) as path:
        assert [each.stat().st_mode & 0o777 for each in (path, path.parent)] == [0o600, 0o700]
        thread = start_browser(path, lambda: None)
        wait_until((browser / "opened").exists)
        address = led_to((browser / "opened").read_text())
        seen = command_lines()
        assert path.as_uri() in seen
        for each in (bench.address, address):
            assert urlsplit(each).query.removeprefix("token=") not in seen
        status, headers = get(address)
        assert status == 200
        assert get(address)[0] == 403  # valid once
        assert get(bench.address.partition("?")[0], Cookie=headers["Set-Cookie"].split(";")[0])[0] == 200
        assert get(bench.address)[0] == 200
        assert thread.is_alive()
        (browser / "end").touch()
        thread.join(PATIENCE)
    assert not path.parent.exists()


def answer_nobody(bench: Workbench, ready: Callable[[], object]) -> None:
    ready()
    for each in bench._sockets:
        each.close()


@pytest.mark.parametrize("command", ["/no/such/browser %s", "'quotes that do not close %s", ""])
def test_browser_that_does_not_start_is_told(
    browser: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    monkeypatch.setattr(threading.Thread, "start", threading.Thread.run)
    monkeypatch.setattr(Workbench, "run", answer_nobody)
    if command:
        register = lambda: setattr(webbrowser, "_tryorder", [command])  # noqa: E731
        monkeypatch.setenv("BROWSER", command)
        monkeypatch.setattr(webbrowser, "register_standard_browsers", register)
    else:  # it had shown the first page, and ended badly later
        monkeypatch.setattr(webbrowser, "open", lambda _address: False)
        monkeypatch.setattr(Workbench, "awaits_browser", False)
    assert workbench(browser / "work") == DONE
    told = capsys.readouterr()
    assert told.err.count("No browser") == told.err.count("\n") == bool(command)
    assert told.out.splitlines()[-1].startswith("http://127.0.0.1:")
