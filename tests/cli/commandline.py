"""The command line for its tests: in this process, since a start costs seconds, or as a process of its own."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from uwgraph.cli import main

UWGRAPH = Path(sys.executable).with_name("uwgraph")

Done = subprocess.CompletedProcess[str]


def run(*arguments: object) -> Done:
    """The entry point in this process."""
    command = ["uwgraph", *map(str, arguments)]
    out, err = io.StringIO(), io.StringIO()
    terminate = signal.getsignal(signal.SIGTERM)
    with redirect_stdout(out), redirect_stderr(err), pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", command)
        try:
            main()
            code: object = 0
        except SystemExit as end:
            code = end.code
        finally:
            signal.signal(signal.SIGTERM, terminate)
    return Done(command, code if isinstance(code, int) else 0, out.getvalue(), err.getvalue())


def started(*arguments: object, preexec: Callable[[], None] | None = None) -> Done:
    """The installed command in a process of its own."""
    command = [str(UWGRAPH), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, preexec_fn=preexec)


def told(done: Done, code: int, *words: str) -> None:
    """It failed with the code and a message for people: no traceback, nothing on standard output."""
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    for word in words:
        assert word in done.stderr
