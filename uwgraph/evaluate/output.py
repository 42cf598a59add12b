"""The folder that a solved dive leaves: trajectory, states, verdicts on closures, metrics, configuration and log."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow.parquet as pq
import yaml

from uwgraph.atomic import atomic_folder
from uwgraph.errors import ConfigError
from uwgraph.evaluate.table import closures_table, solution_table, trajectory_tum
from uwgraph.types import Solution

FILES: Final = ("trajectory.tum", "solution.parquet", "metrics.json", "config.yaml", "run.log")
"""Every output folder holds these, and may hold ``closures.parquet`` and pictures beside them."""


def write_solution(
    solution: Solution,
    out_dir: str | os.PathLike[str],
    metrics: Mapping[str, Any],
    config: Mapping[str, Any],
    log: str,
    *,
    overwrite: bool = False,
    extras: Callable[[Path], None] | None = None,
) -> None:
    """Write the output folder whole, or not at all.

    Parameters
    ----------
    metrics, config : mapping
        Plain values: what :func:`uwgraph.evaluate.metrics.metrics` returns, and the resolved settings.
    log : str
        The text of ``run.log``.
    overwrite : bool
        Replace a former output of uwgraph. Any other folder with something in it is never touched.
    extras : callable, optional
        Called with the folder before it is put in place, to add pictures.

    Raises
    ------
    ConfigError
        When ``out_dir`` is taken.
    DataError
        When the disk is full or the place cannot be written; nothing is left behind.
    """
    refuse_taken(out_dir, overwrite=overwrite)
    with atomic_folder(out_dir, replaces="metrics.json" if overwrite else None) as folder:
        (folder / "trajectory.tum").write_text(trajectory_tum(solution), encoding="utf-8")
        pq.write_table(solution_table(solution), folder / "solution.parquet")
        (folder / "metrics.json").write_text(metrics_json(metrics), encoding="utf-8")
        (folder / "config.yaml").write_text(yaml.safe_dump(dict(config), sort_keys=False), encoding="utf-8")
        (folder / "run.log").write_text(log, encoding="utf-8")
        if solution.closures is not None:
            pq.write_table(closures_table(solution.closures), folder / "closures.parquet")
        if extras is not None:
            extras(folder)


def metrics_json(metrics: Mapping[str, Any]) -> str:
    """The text of ``metrics.json``."""
    return json.dumps(metrics, indent=2, allow_nan=False) + "\n"


def refuse_taken(out_dir: str | os.PathLike[str], *, overwrite: bool, files: Sequence[str] = FILES) -> None:
    """Tell before the long work, not after it, that the output has no place to go.

    Raises
    ------
    ConfigError
        When ``out_dir`` is a file, a folder of something else, or a former output that may not be overwritten.
    """
    folder = Path(out_dir)
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    ours = folder.is_dir() and all((folder / name).is_file() for name in files)
    if ours and overwrite:
        return
    if ours:
        raise ConfigError("holds an earlier result", where=str(folder), remedy="choose another folder, or add --force")
    raise ConfigError(
        "is taken by something that is not a result of uwgraph", where=str(folder), remedy="choose another folder"
    )
