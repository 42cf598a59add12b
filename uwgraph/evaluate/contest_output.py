"""The folder that a contest leaves: figures, pictures, the report, and every estimator's trajectory."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from uwgraph import __version__
from uwgraph.atomic import atomic_folder
from uwgraph.evaluate.contest_plot import contest_plots
from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.evaluate.output import refuse_taken
from uwgraph.evaluate.report import write_report
from uwgraph.evaluate.table import innovations_table, solution_table, trajectory_tum
from uwgraph.plain import json_values

COMPARISON: Final = "comparison.json"
FILES: Final = (COMPARISON, "report.html", "config.yaml")
"""Every folder of a comparison holds these, and pictures and a folder for every estimator beside them."""


def comparison(contest: Contest) -> dict[str, Any]:
    """What ``comparison.json`` holds: ``estimators.NAME`` has the fields of ``metrics.json``, and of filters more."""
    return {
        "dive": contest.title,
        "uwgraph": __version__,
        "simulated": contest.dive.provenance.get("simulated", contest.dive.provenance.get("source") == "simulated"),
        "estimators": {entry.name: {"title": entry.title, **entry.judged.metrics} for entry in contest.entries},
        "failed": dict(contest.failed),
    }


def write_contest(
    contest: Contest, out_dir: str | os.PathLike[str], config: Mapping[str, Any], *, overwrite: bool = False
) -> None:
    """Write the folder whole, or not at all.

    Raises
    ------
    ConfigError
        When ``out_dir`` is taken.
    DataError
        When the disk is full or the place cannot be written; nothing is left behind.
    """
    refuse_taken(out_dir, overwrite=overwrite, files=FILES)
    with atomic_folder(out_dir, replaces=COMPARISON if overwrite else None) as folder:
        text = json.dumps(json_values(comparison(contest)), indent=2, allow_nan=False)
        (folder / COMPARISON).write_text(text + "\n", encoding="utf-8")
        (folder / "config.yaml").write_text(yaml.safe_dump(dict(config), sort_keys=False), encoding="utf-8")
        for entry in contest.entries:
            _write_entry(entry, folder / entry.name)
        contest_plots(contest, folder)
        write_report(contest, folder / "report.html")


def _write_entry(entry: Entry, folder: Path) -> None:
    folder.mkdir()
    solution = entry.judged.solution
    (folder / "trajectory.tum").write_text(trajectory_tum(solution), encoding="utf-8")
    pq.write_table(solution_table(solution), folder / "solution.parquet")
    if entry.innovations is not None:
        table: pa.Table = innovations_table(entry.innovations)
        pq.write_table(table, folder / "innovations.parquet")
