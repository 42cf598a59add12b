"""Outputs that are either whole or not there: written beside their place, then renamed into it."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uwgraph.errors import DataError

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well, and vanishes otherwise.

    Raises
    ------
    DataError
        When the disk is full or the place cannot be written; nothing is left behind.
    """
    target = Path(path)
    with _told(target), _scratch(target) as scratch:
        partial = scratch / target.name
        yield partial
        _sync(partial)
        os.replace(partial, target)
        _sync(target.parent)


@contextmanager
def atomic_folder(path: str | os.PathLike[str], replaces: str | None = None) -> Iterator[Path]:
    """A temporary folder beside ``path`` that takes its place when the block ends well, and vanishes otherwise.

    Parameters
    ----------
    path : path
        The folder to make. It must not exist or be empty, unless ``replaces`` allows otherwise.
    replaces : str, optional
        An existing folder that holds a file of this name is one of ours, and is replaced as a whole.

    Raises
    ------
    DataError
        When the place is taken or cannot be written, or the disk is full; what was there before is untouched.
    """
    target = Path(path)
    refuse_taken(target, replaces)
    with _told(target), _scratch(target) as scratch:
        partial = scratch / target.name
        partial.mkdir()
        yield partial
        for entry in [*partial.rglob("*"), partial]:
            _sync(entry)
        _swap(partial, target, scratch / "previous")
        _sync(target.parent)


def refuse_taken(path: str | os.PathLike[str], replaces: str | None = None) -> None:
    """Raise what :func:`atomic_folder` would when the place is taken, before long work is begun."""
    target = Path(path)
    if not target.is_dir():
        if os.path.lexists(target):
            raise DataError("a file stands where the folder should go", where=str(target), remedy="choose another name")
        return
    if any(target.iterdir()) and not (replaces and (target / replaces).is_file()):
        raise DataError("the folder is not empty", where=str(target), remedy="choose another folder, or empty this one")


def _swap(partial: Path, target: Path, previous: Path) -> None:
    """Put ``partial`` in the place of ``target``; on failure what was there comes back."""
    if target.exists():
        os.rename(target, previous)
    try:
        os.rename(partial, target)
    except BaseException:
        if previous.exists():
            os.rename(previous, target)
        raise


@contextmanager
def _scratch(target: Path) -> Iterator[Path]:
    """A hidden folder beside ``target``, on the same file system so that a rename is atomic."""
    parent = target.absolute().parent
    parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f".{target.name[:100]}.partial-", dir=parent))
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def _told(target: Path) -> Iterator[None]:
    """Operating-system errors of the block in words."""
    try:
        yield
    except OSError as error:
        if error.errno in FULL:
            raise DataError(
                "the disk is full, or a size limit was reached; nothing was written",
                where=str(target),
                remedy="free some space, or write to another disk",
            ) from error
        raise DataError(
            f"cannot be written ({error.strerror or error}); nothing was written",
            where=str(target),
            remedy="check that the folder exists, is writable and is not in use",
        ) from error


def _sync(path: Path) -> None:
    """Push a file or folder to the disk, so that a power cut after the rename finds it whole."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
