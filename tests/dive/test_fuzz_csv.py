"""Mutated tables."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from fuzzing import survives

from uwgraph.dive.importing import import_dive
from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.reading import LogOptions
from uwgraph.types import Origin

START_S = 1_654_646_400


def tables() -> dict[str, bytes]:
    t = START_S + np.arange(60) / 20
    rows = {
        "imu.csv": ("t,ax,ay,az,gx,gy,gz", [*t.repeat(1)[None], *np.tile([[0], [0], [-9.8], [0], [0], [0.1]], 60)]),
        "nav.csv": ("time [s],lat,lon,depth (m),heading", [t, *np.tile([[43.0], [5.0], [3.0], [40.0]], 60)]),
        "dvl.tsv": ("t [ns],vx,vy,vz", [t * 1e9, *np.ones((3, 60))]),
    }
    separators = {"dvl.tsv": "\t"}
    return {
        name: "\n".join(
            separators.get(name, ",").join(cells)
            for cells in [header.split(","), *([f"{x:.10g}" for x in row] for row in np.column_stack(columns))]
        ).encode()
        + b"\n"
        for name, (header, columns) in rows.items()
    }


def test_mutated_tables(tmp_path: Path) -> None:
    dive = tmp_path / "dive"

    def call(folder: Path) -> None:
        shutil.rmtree(dive, ignore_errors=True)
        import_dive(folder, dive, "csv", options=LogOptions(wishes=Wishes(origin=Origin(0.7, 0.1))))

    files = tables()
    (tmp_path / "sound").mkdir()
    for name, content in files.items():
        (tmp_path / "sound" / name).write_bytes(content)
    call(tmp_path / "sound")
    tally = survives(call, files, tmp_path)
    print(tally)
    assert tally.imported > 0
    assert tally.refused > 0
