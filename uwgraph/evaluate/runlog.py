"""The text of ``run.log``: what went in, what the solver did."""

from __future__ import annotations

import platform
from datetime import UTC, datetime
from importlib.metadata import version

import yaml

from uwgraph.dive.model import Dive
from uwgraph.plain import plain
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


def _machine() -> dict[str, str]:
    return {"python": platform.python_version(), "machine": platform.platform(terse=True)}
