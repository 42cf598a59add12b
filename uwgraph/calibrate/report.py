"""A calibration in plain values, and written down: the rig, and beside it what it rests on."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from uwgraph import __version__
from uwgraph.atomic import atomic_file
from uwgraph.calibrate.combine import TOLD
from uwgraph.calibrate.result import Calibration, Estimate
from uwgraph.dive.rigfile import write_rig
from uwgraph.plain import json_values

CRITERION = (
    f"told: 1-sigma at most {TOLD:g} of the prior's, and within the limit of use; all else is left at the rig's value"
)

DOUBTFUL = 5.0
"""Sigmas between a clock by correlation and in the graph, beyond which one of them is wrong."""


def as_plain(calibration: Calibration) -> dict[str, Any]:
    """Everything, as JSON takes it: what is not a number is None."""
    values = {
        "what": calibration.what,
        "converged": calibration.converged,
        "iterations": calibration.iterations,
        "criterion": CRITERION,
        "estimates": [asdict(e) for e in calibration.estimates],
        "clocks": [asdict(e) for e in calibration.clocks],
        "correlations": {
            dive: {sensor: asdict(c) for sensor, c in found.items()} for dive, found in calibration.correlations.items()
        },
        "not_shown": [asdict(u) for u in calibration.unseen],
        "doubts": doubts(calibration),
        "covariance": {"names": calibration.names, "matrix": calibration.covariance},
        "rig": calibration.rig.model_dump(mode="json"),
    }
    plain: dict[str, Any] = json_values(values)
    return plain


def doubts(calibration: Calibration) -> list[str]:
    """Clocks of which graph and correlation say different things: then something fixed in the rig is wrong."""
    found = []
    for dive, correlations in calibration.correlations.items():
        for sensor, correlated in correlations.items():
            own = f"{sensor}.time_offset_s"
            refined = next((e for e in calibration.clocks if e.name == f"{dive}: {own}"), None) or next(
                (e for e in calibration.estimates if e.name == own), None
            )
            if refined is None or not refined.observable or not correlated.observable:
                continue
            apart = abs(refined.after - correlated.offset_s)
            if apart > DOUBTFUL * np.hypot(refined.sigma, correlated.sigma_s):
                found.append(
                    f"{dive}: {own} is {refined.after:.3f} s in the graph, {correlated.offset_s:.3f} s by correlation: "
                    "a lever arm, mounting or axis in the rig is wrong, and all sigmas with it; calibrate dvl first"
                )
    return found


def report_file(rig_file: Path) -> Path:
    """Where the report of a rig file goes: beside it."""
    return rig_file.with_suffix(".json")


def write_calibration(calibration: Calibration, rig_file: Path) -> None:
    """The rig as YAML, and the report with the covariance beside it as JSON; each whole or not at all.

    Raises
    ------
    DataError
        When the place cannot be written.
    """
    dives = ", ".join(calibration.rigs)
    told = [line(e) for e in calibration.estimates if e.observable]
    remarks = [f"uwgraph {__version__}, calibrate {calibration.what} from {dives}", *told]
    remarks += [f"not told: {u.text}" for u in calibration.unseen]
    with atomic_file(report_file(rig_file)) as partial:
        partial.write_text(json.dumps(as_plain(calibration), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    write_rig(calibration.rig, rig_file, [*remarks, f"covariance: {report_file(rig_file).name}"])


def line(e: Estimate) -> str:
    """As in ``dvl.scale 0.99884 +- 0.0006``."""
    return f"{e.name} {figure(e.after, e.sigma)} +- {e.sigma:.2g} {e.unit}".rstrip()


def figure(value: float, sigma: float) -> str:
    """A value with two digits of its sigma."""
    digits = 2 - int(np.floor(np.log10(sigma))) - 1 if 0.0 < sigma < np.inf else 4
    return f"{value:.{min(max(digits, 0), 9)}f}"
