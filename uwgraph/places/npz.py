"""Arrays in ``.npz`` files: written whole or not at all, read without pickle and never larger than expected."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.atomic import atomic_file
from uwgraph.errors import DataError

_AGAIN: Final = "write the file again"
Arrays = dict[str, NDArray[Any]]


def write_npz(path: str | Path, what: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays; ``what`` names the kind of file."""
    named: dict[str, Any] = {"what": np.array(what), **arrays}
    with atomic_file(path) as partial, partial.open("wb") as file:
        np.savez(file, **named)


def read_npz(path: str | Path, what: str) -> Arrays:
    """The arrays that :func:`write_npz` wrote as ``what``; numbers are finite.

    Raises
    ------
    DataError
        When the file is missing, damaged, too large, or of another kind.
    """
    where, remedy = str(path), f"give a file of a {what}"
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > Path(path).stat().st_size:
            raise DataError(f"unpacks to {size} bytes, more than it has", where=where, remedy=remedy)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
    except (OSError, KeyError, ValueError, TypeError, EOFError, SyntaxError, MemoryError, zipfile.BadZipFile) as error:
        raise DataError(f"cannot be read ({str(error)[:100]})", where=where, remedy=remedy) from error
    kind = str(arrays.pop("what", "something else"))[:80]
    if kind != what:
        raise DataError(f"is no {what} but a file of {kind}", where=where, remedy=remedy)
    return arrays


def checked(
    arrays: Arrays, name: str, shape: tuple[int | None, ...], where: str, kind: str, *, finite: bool = True
) -> NDArray[Any]:
    """One array of the expected shape (None: any length) and NumPy kind (``"f"``, ``"i"``, ``"U"``).

    Raises
    ------
    DataError
        When it is missing or another, or its numbers are not finite.
    """
    array = arrays.get(name)
    if array is None:
        raise DataError(f"{name} is missing", where=where, remedy=_AGAIN)
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind != kind:
        raise DataError(f"{name} is {array.dtype} of shape {array.shape}", where=where, remedy=_AGAIN)
    if finite and kind == "f" and not np.all(np.isfinite(array)):
        raise DataError(f"{name} holds values that are not finite", where=where, remedy=_AGAIN)
    return array


def json_value(arrays: Arrays, name: str, where: str) -> Any:
    """The value of a JSON text among the arrays."""
    try:
        return json.loads(str(checked(arrays, name, (), where, "U")))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{name} is not JSON ({str(error)[:80]})", where=where, remedy=_AGAIN) from error
