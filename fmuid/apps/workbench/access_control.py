"""Access control: one browser, that of the user who started the workbench.

Every page and program on this machine reaches a server on 127.0.0.1. Each request is checked before Bokeh: its Host
(DNS rebinding), its Origin (foreign pages) and a cookie. The first address has a token, which gives the cookie.
"""

from __future__ import annotations

import contextlib
import hmac
import secrets
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any
from urllib.parse import parse_qsl, urlencode

from bokeh.server.connection import ServerConnection
from bokeh.server.session import ServerSession
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.ws import WSHandler
from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.web import ErrorHandler, OutputTransform, RequestHandler
from tornado.websocket import WebSocketClosedError

SCHEME = "fmuid-scheme"  # cookie and page argument: "dark" or "light"
LARGEST_MESSAGE = 64 * 2**20  # bytes, of an upload


class Guard(BokehTornado):  # type: ignore[misc]
    """Bokeh's application with access control for `hosts` (``name:port``); `patterns` are handlers of plain pages."""

    def __init__(self, applications: Mapping[str, Any], hosts: Sequence[str], patterns: list[Any]) -> None:
        self.token, self._secret, self._hosts = secrets.token_urlsafe(24), secrets.token_urlsafe(24), tuple(hosts)
        self._single_use_tokens: set[str] = set()
        self._cookie = f"fmuid-{secrets.token_hex(4)}"  # cookies are shared by all ports
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
            session_token_expiration=300,
            keep_alive_milliseconds=10_000,
            check_unused_sessions_milliseconds=500,
            unused_session_lifetime_milliseconds=15_000,
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
        )
        self.add_transform(_headers(_policy(self._hosts)))

    def single_use_token(self) -> str:
        """Return a token that is valid once."""
        token = secrets.token_urlsafe(24)
        self._single_use_tokens.add(token)
        return token

    @property
    def awaits_browser(self) -> bool:
        """Whether a single-use token is unused."""
        return bool(self._single_use_tokens)

    def _accept(self, given: bytes) -> bool:
        """Return whether a token is valid; discard a single-use token."""
        for token in self._single_use_tokens:
            if hmac.compare_digest(given, token.encode()):
                self._single_use_tokens.discard(token)
                return True
        return hmac.compare_digest(given, self.token.encode())

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> Any:
        """Return the handler of a request; refuse all but the user's browser."""
        origin = request.headers.get("Origin")
        foreign = request.host not in self._hosts or (origin is not None and origin not in self._origins)
        # autoload.js gives any origin a session token
        if foreign or request.path.endswith("/autoload.js"):
            return self._refuse(request)
        given = request.arguments.get("token", [b""])[-1]
        if request.method == "GET" and given and self._accept(given):
            return self.get_handler_delegate(request, LoginHandler, {"secret": self._secret, "name": self._cookie})
        cookies = {name: each.value for name, each in request.cookies.items()}
        if request.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            return self._refuse(request)
        if not hmac.compare_digest(cookies.get(self._cookie, "").encode(), self._secret.encode()):
            return self._refuse(request)
        request.arguments[SCHEME] = [b"dark" if cookies.get(SCHEME) == "dark" else b"light"]
        return super().find_handler(request, **kwargs)

    def get_handler_delegate(self, request: HTTPServerRequest, target_class: Any, *given: Any, **named: Any) -> Any:
        """Return the handler of a request, with `TabSocket` for Bokeh's websockets."""
        target = TabSocket if target_class is WSHandler else target_class
        return super().get_handler_delegate(request, target, *given, **named)

    def _refuse(self, request: HTTPServerRequest) -> Any:
        return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})


class LoginHandler(RequestHandler):
    """Exchange of a token for the cookie; later addresses have no token."""

    def initialize(self, secret: str, name: str) -> None:
        """Take name and content of the cookie."""
        self._given = name, secret

    def get(self) -> None:
        """Set the cookie, and go on without the token."""
        # for a redirect, a cross-site request, ``SameSite=Strict`` cookies would not be sent
        self.set_cookie(*self._given, httponly=True, samesite="Strict")
        rest = [(key, value) for key, value in parse_qsl(self.request.query) if key != "token"]
        self.write(redirecting_page("/" + self.request.path.lstrip("/") + ("?" + urlencode(rest) if rest else "")))


class TabSocket(WSHandler):  # type: ignore[misc]
    """Websocket of a tab, whose session ends with it; Bokeh would keep it for pages that reconnect."""

    connection: ServerConnection | None
    _session: ServerSession

    @property
    def is_open(self) -> bool:
        """Whether messages can be exchanged."""
        return self.ws_connection is not None and not self.ws_connection.is_closing()

    async def _async_open(self, token: str) -> None:
        await super()._async_open(token)
        assert self.connection is not None
        self._session = self.connection.session
        if not self.is_open:  # closed during the start of the session
            self.on_close()

    async def on_message(self, fragment: str | bytes) -> None:
        """Handle a message of an open tab."""
        if self.is_open:
            await super().on_message(fragment)

    async def send_message(self, message: Any) -> None:
        """Send a message to an open tab."""
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
    """Return an HTML page that leads to another address."""
    return _REDIRECTING.format(escape(address))


def _policy(hosts: Sequence[str]) -> str:
    sockets = " ".join(f"ws://{host}" for host in hosts)
    return (
        f"default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
        f"font-src data:; connect-src 'self' {sockets}; frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
    )


# A report runs its own scripts, without an origin: they cannot reach the workbench.
_REPORT_POLICY = "sandbox allow-scripts allow-popups allow-downloads allow-modals; frame-ancestors 'none'"


def _headers(policy: str) -> type[OutputTransform]:
    """Return a transform that adds headers to every answer."""
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
