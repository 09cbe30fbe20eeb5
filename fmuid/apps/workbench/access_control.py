"""Who may talk to the workbench: one browser, that of the user who started it.

A server on 127.0.0.1 is reached by every page that the user's browser shows and by every program on the machine. Each
request is judged here before anything of Bokeh sees it, for pages, static files and websockets alike: by its Host (a
foreign name that resolves to this machine), its Origin (a foreign page), and a cookie. The browser gets the cookie in
exchange for a token in the first address.
"""

from __future__ import annotations

import contextlib
import hmac
import secrets
from collections.abc import Mapping, Sequence
from html import escape
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, urlencode

from bokeh.server.connection import ServerConnection
from bokeh.server.session import ServerSession
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.ws import WSHandler
from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.web import ErrorHandler, OutputTransform, RequestHandler
from tornado.websocket import WebSocketClosedError

SCHEME = "fmuid-scheme"
"""The cookie, and the argument of a page, that says whether the browser shows dark pages."""
# Seconds for which a page that was asked for may open its websocket.
SESSION_SECONDS = 300
LARGEST_MESSAGE = 64 * 2**20
"""Bytes of an upload."""


class Guard(BokehTornado):  # type: ignore[misc]
    """Bokeh's application, which answers only whom it knows.

    Parameters
    ----------
    applications : mapping
        As for Bokeh.
    hosts : sequence of str
        ``name:port`` as they may stand in an address, the one for people first.
    patterns : list
        Handlers of plain pages.

    Attributes
    ----------
    token : str
        Token of the address for people, valid as long as the server runs.
    """

    def __init__(self, applications: Mapping[str, Any], hosts: Sequence[str], patterns: list[Any]) -> None:
        self.token, self._secret, self._hosts = secrets.token_urlsafe(24), secrets.token_urlsafe(24), tuple(hosts)
        self._single_use_tokens: set[str] = set()
        self._cookie = f"fmuid-{secrets.token_hex(4)}"  # cookies do not tell ports apart
        self._origins = {f"http://{host}" for host in hosts}
        super().__init__(
            dict(applications),
            extra_websocket_origins=list(hosts),
            extra_patterns=patterns,
            use_index=False,
            redirect_root=False,
            secret_key=secrets.token_bytes(32),
            sign_sessions=True,
            include_headers=[],
            include_cookies=[],
            session_token_expiration=SESSION_SECONDS,
            keep_alive_milliseconds=10_000,
            check_unused_sessions_milliseconds=500,
            unused_session_lifetime_milliseconds=15_000,
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
        )
        self.add_transform(_headers(_policy(self._hosts)))

    def single_use_token(self) -> str:
        """Return a token that lets a browser in once."""
        token = secrets.token_urlsafe(24)
        self._single_use_tokens.add(token)
        return token

    @property
    def awaits_browser(self) -> bool:
        """Whether a single-use token has not been used."""
        return bool(self._single_use_tokens)

    def _accept(self, given: bytes) -> bool:
        """Return whether a token lets a browser in; a single-use token does so no more."""
        for token in self._single_use_tokens:
            if hmac.compare_digest(given, token.encode()):
                self._single_use_tokens.discard(token)
                return True
        return hmac.compare_digest(given, self.token.encode())

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> Any:
        """Return who answers a request: 403 to all that is not of the user's own browser."""
        origin = request.headers.get("Origin")
        foreign = request.host not in self._hosts or (origin is not None and origin not in self._origins)
        # autoload.js answers any origin, with a session's token
        if foreign or request.path.endswith("/autoload.js"):
            return self._refuse(request)
        given = request.arguments.get("token", [b""])[-1]
        if request.method == "GET" and given and self._accept(given):
            return self.get_handler_delegate(request, LoginHandler, {"secret": self._secret, "name": self._cookie})
        cookies, site = _cookies(request), request.headers.get("Sec-Fetch-Site", "none")
        if site not in ("none", "same-origin"):
            return self._refuse(request)
        if not hmac.compare_digest(cookies.get(self._cookie, "").encode(), self._secret.encode()):
            return self._refuse(request)
        request.arguments[SCHEME] = [b"dark" if cookies.get(SCHEME) == "dark" else b"light"]
        return super().find_handler(request, **kwargs)

    def get_handler_delegate(self, request: HTTPServerRequest, target_class: Any, *given: Any, **named: Any) -> Any:
        """Return who answers a request with a handler; `TabSocket` stands in for Bokeh's websockets."""
        target = TabSocket if target_class is WSHandler else target_class
        return super().get_handler_delegate(request, target, *given, **named)

    def _refuse(self, request: HTTPServerRequest) -> Any:
        return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})


class LoginHandler(RequestHandler):
    """Exchange of a token for the cookie; no later address carries a token."""

    def initialize(self, secret: str, name: str) -> None:
        """Take the content of the cookie."""
        self._given = name, secret

    def get(self) -> None:
        """Set the cookie and lead on without the token.

        A redirect would go on as a request of the page before, with which a browser sends no cookie of
        ``SameSite=Strict``.
        """
        self.set_cookie(*self._given, httponly=True, samesite="Strict")
        rest = [(key, value) for key, value in parse_qsl(self.request.query) if key != "token"]
        self.write(redirecting_page("/" + self.request.path.lstrip("/") + ("?" + urlencode(rest) if rest else "")))


class TabSocket(WSHandler):  # type: ignore[misc]
    """Websocket of a tab.

    A page never comes back to a session whose websocket it has lost (``reconnect_session`` is off), so that the session
    ends with it. Bokeh keeps it for a while, and handles messages that have arrived before the end without it.
    """

    connection: ServerConnection | None
    _session: ServerSession

    @property
    def is_open(self) -> bool:
        """Whether messages can still be exchanged."""
        return self.ws_connection is not None and not self.ws_connection.is_closing()

    async def _async_open(self, token: str) -> None:
        await super()._async_open(token)
        assert self.connection is not None
        self._session = self.connection.session
        if not self.is_open:  # closed while the session was being made
            self.on_close()

    async def on_message(self, fragment: str | bytes) -> None:
        """Handle a message of a tab that is open."""
        if self.is_open:
            await super().on_message(fragment)

    async def send_message(self, message: Any) -> None:
        """Send a message to a tab that is open."""
        with contextlib.suppress(WebSocketClosedError):
            await message.send(self)

    def on_close(self) -> None:
        """End the session."""
        connection, self.connection = self.connection, None
        if connection is not None:
            self._session.request_expiration()
            self.application.client_lost(connection)


_REDIRECTING = (
    '<!doctype html><html lang="en"><meta charset="utf-8"><title>fmuid</title>'
    '<meta http-equiv="refresh" content="0;url={0}"><a href="{0}">Open the workbench</a></html>\n'
)


def redirecting_page(address: str) -> str:
    """Return a page of HTML that leads to another address at once."""
    return _REDIRECTING.format(escape(address))


def _cookies(request: HTTPServerRequest) -> dict[str, str]:
    """Return the cookies of a request; none where another program of this machine has set one that is no cookie."""
    try:
        found = SimpleCookie(request.headers.get("Cookie", ""))
    except CookieError:
        return {}
    return {name: morsel.value for name, morsel in found.items()}


def _policy(hosts: Sequence[str]) -> str:
    sockets = " ".join(f"ws://{host}" for host in hosts)
    return (
        f"default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
        f"font-src data:; connect-src 'self' {sockets}; frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
    )


# A report has its scripts in itself: it may run them, as a page of no origin, which reaches nothing of the workbench.
_REPORT_POLICY = "sandbox allow-scripts allow-popups allow-downloads allow-modals; frame-ancestors 'none'"


def _headers(policy: str) -> type[OutputTransform]:
    """Return what adds headers to every answer, refusals and static files included."""
    always = {
        "X-Frame-Options": "DENY",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
    }

    class Headers(OutputTransform):
        def __init__(self, request: HTTPServerRequest) -> None:
            self._path = request.path

        def transform_first_chunk(
            self, status_code: int, headers: HTTPHeaders, chunk: bytes, _finishing: bool
        ) -> tuple[int, HTTPHeaders, bytes]:
            for name, value in always.items():
                headers[name] = value
            headers["Content-Security-Policy"] = _REPORT_POLICY if self._path.startswith("/file/") else policy
            if not self._path.startswith("/static/"):
                headers["Cache-Control"] = "no-store"
            return status_code, headers, chunk

    return Headers
