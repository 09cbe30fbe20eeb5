"""The folder of a batch's own workers: locked while a process has to do with it, and removed by the next batch else.

The lock is of the open file (``flock``) and inherited: it lasts until the last process that has it ends, however it
does. A lock file appears under its name with the lock already on it, so that no folder is ever removed that is in use.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

from fmuid.errors import FmuidError
from fmuid.files import file_name

try:
    import fcntl
except ImportError:  # of POSIX systems; Windows removes no folder that is in use, but leaves those of killed processes
    fcntl = None  # type: ignore[assignment]

PREFIX = "fmuid-batch-"


@contextlib.contextmanager
def scratch_folder() -> Iterator[tuple[Path, list[int]]]:
    """Give a new folder of the user's alone, and the descriptors by which processes that use it keep it locked.

    Folders of this user on this machine whose processes have all ended are removed first.

    Raises
    ------
    FmuidError
        If it cannot be made.
    """
    _sweep(Path(tempfile.gettempdir()))
    try:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX))
    except OSError as error:
        raise FmuidError(
            f"no folder for workers can be made in {tempfile.gettempdir()}: {error.strerror}; make room, or name "
            "another place by the environment variable TMPDIR"
        ) from None
    with contextlib.ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        draft = folder / "draft"
        handle = _locked(draft, os.O_CREAT)
        if handle is not None:
            stack.callback(os.close, handle)
            draft.rename(folder / _lock_name())
        yield folder, [] if handle is None else [handle]


def _sweep(place: Path) -> None:
    """Remove the folders of this user that nobody has locked any more."""
    for folder in place.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # another batch was faster, or it is somebody else's
            if folder.is_symlink() or folder.stat().st_uid != os.geteuid():
                continue
            handle = _locked(folder / _lock_name())
            if handle is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(handle)


def _locked(path: Path, flags: int = 0) -> int | None:
    """Return the descriptor of a file with its lock; None where somebody has it or there is none."""
    if fcntl is None:
        return None
    try:
        handle = os.open(path, os.O_RDWR | flags, 0o600)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


def _lock_name() -> str:
    """Return the name of lock files of this machine: some shared folders do not tell others of locks."""
    return f"lock-{file_name(socket.gethostname())}"
