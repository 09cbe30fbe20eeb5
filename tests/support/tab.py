"""A tab without a browser: what its script says to a workbench through a websocket."""

import http.client
import json
import re
from collections.abc import Mapping
from http.client import HTTPMessage
from typing import Any
from urllib.parse import urlsplit

from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

PATIENCE = 60.0


class Tab:
    """A page that is open."""

    def __init__(self, address: str, page: str) -> None:
        self._host, self._page = urlsplit(address).netloc, page
        cookie = self._get(f"/?{urlsplit(address).query}", {})[0]["Set-Cookie"].split(";")[0]
        self._headers = {"Cookie": cookie, "Origin": f"http://{self._host}"}
        self._token = re.findall(r'"token": "([^"]+)"', self._get(page, self._headers)[1])[0]
        self._socket: WebSocketClientConnection | None = None

    def _get(self, path: str, headers: Mapping[str, str]) -> tuple[HTTPMessage, str]:
        connection = http.client.HTTPConnection(self._host, timeout=PATIENCE)
        try:
            connection.request("GET", path, headers=dict(headers))
            answer = connection.getresponse()
            return answer.headers, answer.read().decode()
        finally:
            connection.close()

    async def open(self) -> None:
        """Open the websocket, and wait for the first answer."""
        path = self._page.partition("?")[0]
        request = HTTPRequest(f"ws://{self._host}{path}/ws", headers=self._headers)
        self._socket = await websocket_connect(request, subprotocols=["bokeh", self._token])
        await self._message()

    async def models(self) -> dict[str, str]:
        """Return the identifiers of the page's models by their names."""
        self.send("PULL-DOC-REQ", {})
        found: dict[str, str] = {}

        def look(value: Any) -> None:
            for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
                look(each)
            if isinstance(value, dict) and isinstance(name := value.get("attributes", {}).get("name"), str):
                found[name] = value["id"]

        look((await self._message())["doc"])
        return found

    def change(self, model: str, attribute: str, value: object) -> None:
        """Change an attribute of a model."""
        event = {"kind": "ModelChanged", "model": {"id": model}, "attr": attribute, "new": value}
        self.send("PATCH-DOC", {"events": [event]})

    def send(self, kind: str, content: object) -> None:
        """Send a message."""
        assert self._socket is not None
        for part in ({"msgid": "1", "msgtype": kind}, {}, content):
            self._socket.write_message(json.dumps(part))

    def drop(self) -> None:
        """Cut the connection without a word."""
        assert self._socket is not None
        wire: Any = self._socket.protocol
        wire.stream.close()
        self._socket.close()

    async def _message(self) -> Any:
        """Return the content of the next message, of three parts."""
        assert self._socket is not None
        return [json.loads(str(await self._socket.read_message())) for _ in range(3)][2]
