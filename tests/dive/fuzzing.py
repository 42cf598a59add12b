"""Mutated recordings: whatever a file holds, importing it ends in time, within memory, and in words or well.

The number of cases comes from the environment, ``UWGRAPH_FUZZ=10000``; without it, what fits into a few seconds.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import random
import resource
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from uwgraph.errors import UwgraphError

BUDGET_S = 4.0
"""How long a test runs where the environment does not say how many cases."""
LIMIT_S = 20.0
"""Longest case, on a machine that does other things as well."""
LIMIT_MB = 1024
"""Most address space that a case may take on top of what the process has."""
_LENGTHS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)


class TooLong(BaseException):
    """A case ran into the wall limit; no ``except Exception`` of a reader stops it."""


@dataclass
class Tally:
    """What became of the cases."""

    cases: int = 0
    imported: int = 0
    refused: int = 0
    worst_s: float = 0.0
    worst_mb: float = 0.0

    def __str__(self) -> str:
        return (
            f"{self.cases} cases: {self.imported} imported, {self.refused} refused in words; "
            f"worst {self.worst_s:.2f} s, {self.worst_mb:.0f} MB"
        )


def mutations(data: bytes, seed: int) -> bytes:
    """One to four faults of a disk, a wire or an enemy, the same for the same seed."""
    rng = random.Random(seed)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if data:
            data = rng.choice(_KINDS)(data, rng)
    return data


def survives(
    import_call: Callable[[Path], object],
    files: Mapping[str, bytes],
    work: Path,
    *,
    cases: int | None = None,
    first_seed: int = 0,
) -> Tally:
    """Import recordings in which one file is mutated, and insist on success or an error in words.

    Parameters
    ----------
    import_call : callable
        Imports what lies in the folder it is given. A result that is a folder is removed by the caller.
    files : mapping
        Names relative to that folder, and the sound contents.
    work : Path
        A temporary folder.
    cases, first_seed : int, optional
        How many; by default ``UWGRAPH_FUZZ``, else as many as fit into :data:`BUDGET_S`.

    Raises
    ------
    AssertionError
        For the first case that raises anything else, takes too long or too much memory, naming its seed. The mutated
        recording is kept in ``work``.
    """
    count = cases if cases is not None else int(os.environ.get("UWGRAPH_FUZZ", "0"))
    tally, names, started = Tally(), sorted(files), time.monotonic()
    folder = work / "mutated"
    while tally.cases < count if count else time.monotonic() - started < BUDGET_S:
        seed = first_seed + tally.cases
        name = names[seed % len(names)]
        shutil.rmtree(folder, ignore_errors=True)
        for other, content in files.items():
            (folder / other).parent.mkdir(parents=True, exist_ok=True)
            (folder / other).write_bytes(mutations(content, seed) if other == name else content)
        _one(import_call, folder, f"seed {seed}, file {name}", tally)
    shutil.rmtree(folder, ignore_errors=True)
    return tally


def _one(import_call: Callable[[Path], object], folder: Path, case: str, tally: Tally) -> None:
    before_mb, started = _resident_mb("VmRSS"), time.monotonic()
    _forget_peak()
    try:
        with _wall_limit(LIMIT_S), _memory_limit(LIMIT_MB):
            import_call(folder)
        tally.imported += 1
    except UwgraphError as error:
        if not error.problem:
            raise AssertionError(f"{case}: an error without words") from error
        tally.refused += 1
    except TooLong as error:
        raise AssertionError(f"{case}: longer than {LIMIT_S} s") from error
    except Exception as error:
        raise AssertionError(f"{case}: {type(error).__name__}: {error}") from error
    tally.cases += 1
    tally.worst_s = max(tally.worst_s, time.monotonic() - started)
    tally.worst_mb = max(tally.worst_mb, _resident_mb("VmHWM") - before_mb)
    if tally.cases % 200 == 0:
        gc.collect()


@contextmanager
def _wall_limit(seconds: float) -> Iterator[None]:
    """TooLong after ``seconds``; where even that is not heard (inside a library), the process ends with a traceback."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise TooLong

    previous = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    faulthandler.dump_traceback_later(3 * seconds, exit=True)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGALRM, previous)


@contextmanager
def _memory_limit(megabytes: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + (megabytes << 20)
    resource.setrlimit(resource.RLIMIT_AS, (limit if soft < 0 else min(limit, soft), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _resident_mb(key: str) -> float:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return int(line.split()[1]) / 1024


def _forget_peak() -> None:
    """Start ``VmHWM`` anew."""
    Path("/proc/self/clear_refs").write_text("5")


def _flip_bits(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 2, 8, 64))):
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _overwrite(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    run = rng.choice((b"\0", b"\xff", rng.randbytes(1), None))
    length = rng.choice((1, 2, 4, 8, 64, 512))
    return data[:at] + (run * length if run else rng.randbytes(length)) + data[at + length :]


def _truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _behead(data: bytes, rng: random.Random) -> bytes:
    return data[rng.randrange(min(len(data), 4096)) :]


def _edit_length(data: bytes, rng: random.Random) -> bytes:
    """A number somewhere, most likely near the start of a block, becomes far too large, zero or one off."""
    width = rng.choice((1, 2, 4, 8))
    at = rng.randrange(max(1, len(data) - width))
    now = int.from_bytes(data[at : at + width], "little")
    value = rng.choice((*_LENGTHS, now + 1, now - 1, now * 2, len(data))) % (1 << 8 * width)
    return data[:at] + value.to_bytes(width, rng.choice(("little", "big"))) + data[at + width :]


def _insert(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + rng.choice((b"\xff", b"\0", rng.randbytes(1))) * rng.choice((1, 4, 16, 256)) + data[at:]


def _remove(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + data[at + rng.choice((1, 4, 16, 256)) :]


def _block(data: bytes, rng: random.Random) -> tuple[int, int]:
    at = rng.randrange(len(data))
    return at, min(len(data), at + rng.randrange(1, 1 + min(len(data), 4096)))


def _splice(data: bytes, rng: random.Random) -> bytes:
    """A block once more, somewhere else."""
    (start, end), at = _block(data, rng), rng.randrange(len(data))
    return data[:at] + data[start:end] + data[at:]


def _swap(data: bytes, rng: random.Random) -> bytes:
    (a, b), (c, d) = sorted((_block(data, rng), _block(data, rng)))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:] if b <= c else data[:a] + data[b:d] + data[a:]


_KINDS = (
    _flip_bits,
    _overwrite,
    _truncate,
    _behead,
    _edit_length,
    _edit_length,
    _edit_length,
    _insert,
    _remove,
    _splice,
    _swap,
)
