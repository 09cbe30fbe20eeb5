"""Websockets of the pages: a closed one is served no more, and its session ends."""

from __future__ import annotations

import contextlib
from typing import Any

from bokeh.server.connection import ServerConnection
from bokeh.server.session import ServerSession
from bokeh.server.views.ws import WSHandler
from tornado.websocket import WebSocketClosedError


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
