"""A wire between a browser and a workbench that can be cut and mended."""

import contextlib
import socket
import threading


class Wire:
    """Passes on what comes to an address of this machine, once it is mended."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._address, self.server = address, address
        self._open: list[socket.socket] = []

    def mend(self) -> None:
        """Let them through again."""
        listening = socket.create_server(self._address)
        self._open.append(listening)
        threading.Thread(target=self._accept, args=(listening,), daemon=True).start()

    def cut(self) -> None:
        """Cut all that is connected, and refuse what comes."""
        while self._open:
            each = self._open.pop()
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _accept(self, listening: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = listening.accept()
                far = socket.create_connection(self.server)
                self._open += [near, far]
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=_pass_on, args=pair, daemon=True).start()


def _pass_on(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while content := source.recv(2**16):
            target.sendall(content)
    for each in (source, target):
        with contextlib.suppress(OSError):
            each.shutdown(socket.SHUT_RDWR)
