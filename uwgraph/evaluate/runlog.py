"""The text of ``run.log``: what went in, what the solver did."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
import yaml

from uwgraph.dive.model import Dive
from uwgraph.time import isoformat
from uwgraph.types import Solution


def run_log(dive: Dive, solution: Solution) -> str:
    """YAML, so that it can be read by both people and programs: versions, streams, provenance, the solver's account."""
    account = {
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {name: version(name) for name in ("uwgraph", "gtsam", "numpy")} | _machine(),
        "streams": {
            name: {"samples": len(s), "from": isoformat(s.t_ns[0]), "to": isoformat(s.t_ns[-1])}
            for name, s in dive.streams()
            if len(s)
        },
        "provenance": plain(dive.provenance),
        "solver": plain(solution.info),
        "calibration": plain(solution.calibration),
    }
    return yaml.safe_dump(account, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)


def plain(value: Any) -> Any:
    """NumPy values, tuples and anything else as the plain values that YAML and JSON know."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def _machine() -> dict[str, str]:
    return {"python": platform.python_version(), "machine": platform.platform(terse=True)}
