"""Writes files that appear only when they are complete, and temporary folders.

A lock marks what a running process still writes. What a killed process left behind has no lock; the
next process that writes there removes it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path

from iits_mj.core.errors import InputError

_PARTIAL = ".iits_mj_partial"
_OWNER = "owner.lock"
TEMPORARY = "iits_mj_"  # the beginning of every temporary folder's name


class OutputFile:
    """A file that is written at `partial`, beside its place, and moved there when complete.

    As a context manager it yields `partial`; an exception in the block removes it, and an older
    file stays as it was.

    Args:
      path: of the file.
      what: the file's kind, for messages.

    Raises:
      InputError: the file cannot be written, or another process is writing it.
    """

    def __init__(self, path: str | Path, what: str) -> None:
        self.path = Path(path)
        self.what = what
        self.partial = self.path.with_name(f".{self.path.stem}{_PARTIAL}{self.path.suffix}")
        self._lock: int | None = None
        with self.errors():
            _sweep_partial(self.path.parent)
            lock = os.open(self.partial, os.O_RDWR | os.O_CREAT, 0o666)
        if not _locked(lock):
            os.close(lock)
            raise InputError(f"{what} {str(path)!r}: another process is writing it")
        self._lock = lock

    def __enter__(self) -> Path:
        return self.partial

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> None:
        del trace
        if kind is None:
            self.finish()
            return
        self.abandon()
        if isinstance(error, OSError):
            raise unwritable(self.what, self.path, error) from error

    @contextlib.contextmanager
    def errors(self) -> Iterator[None]:
        """Turns an OSError of the block into an InputError that names the file."""
        try:
            yield
        except OSError as error:
            raise unwritable(self.what, self.path, error) from error

    def finish(self) -> None:
        """Moves the complete file to its place."""
        if self._lock is not None:
            try:
                with self.errors():
                    self.partial.replace(self.path)
            finally:
                self.abandon()

    def abandon(self) -> None:
        """Removes what was written; an older file stays as it was."""
        if self._lock is not None:
            self.partial.unlink(missing_ok=True)
            self._release()

    def _release(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def unwritable(what: str, path: str | Path, error: Exception) -> InputError:
    """The error that names an output, such as "table", its path and the reason."""
    reason = getattr(error, "strerror", None) or str(error)
    return InputError(f"{what} {str(path)!r} cannot be written: {reason}")


def write_whole(path: str | Path, content: bytes, what: str) -> None:
    """Writes a file so that no reader sees it incomplete; errors as of `OutputFile`."""
    with OutputFile(path, what) as partial:
        partial.write_bytes(content)


class TemporaryFolder:
    """A folder that is removed with this object, or by a later process if this one is killed.

    Args:
      name: part of the folder's name.

    Raises:
      OSError: it cannot be made.
    """

    def __init__(self, name: str) -> None:
        _sweep_folders(Path(tempfile.gettempdir()))
        self.path = Path(tempfile.mkdtemp(prefix=f"{TEMPORARY}{name}_"))
        # Locked before it gets its name: no other process finds it without a lock.
        unnamed = self.path / "owner"
        lock = os.open(unnamed, os.O_RDWR | os.O_CREAT, 0o600)
        _locked(lock)
        unnamed.rename(self.path / _OWNER)
        self._finalizer = weakref.finalize(self, _remove, self.path, lock)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *error: object) -> None:
        self.cleanup()

    def cleanup(self) -> None:
        """Removes the folder; a second call does nothing."""
        self._finalizer()


def _remove(path: Path, lock: int) -> None:
    shutil.rmtree(path, ignore_errors=True)
    os.close(lock)


def _locked(descriptor: int) -> bool:
    """Locks a file for this process; False when another process has locked it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


@contextlib.contextmanager
def _abandoned(path: Path) -> Iterator[bool]:
    """True in the block when no process holds the lock of an existing file."""
    try:
        descriptor = os.open(path, os.O_RDWR)
    except OSError:
        yield False
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        yield False
    else:
        yield True
    finally:
        os.close(descriptor)


def _sweep_partial(folder: Path) -> None:
    for path in folder.glob(f".*{_PARTIAL}*"):
        with _abandoned(path) as abandoned:
            if abandoned:
                path.unlink(missing_ok=True)


def _sweep_folders(parent: Path) -> None:
    for folder in parent.glob(f"{TEMPORARY}*"):
        with _abandoned(folder / _OWNER) as abandoned:
            if abandoned:
                shutil.rmtree(folder, ignore_errors=True)
