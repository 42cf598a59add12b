"""A log of your own in CSV files: what its columns mean is said in a mapping, then it is imported and smoothed.

    python examples/05_own_csv.py [seconds]

The log is simulated, and written as some logger might: axes forward-left-up, g and degrees per second, absolute
pressure in mbar, milliseconds since it was switched on, column names that tell nothing. The mapping is YAML as
``uwgraph import LOG DIVE --mapping FILE`` takes it; ``uwgraph import --list LOG`` shows the columns to map.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import gsw
import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.logs.reading import LogOptions
from uwgraph.dive.yamlfile import parse_settings, parse_yaml
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import SimulationSettings, simulate

MAPPING = """
origin: {lat_deg: 43.0, lon_deg: 7.5}
streams:
  imu:   {topic: xsens.csv, time: 'ms [ms]', epoch: 2024-09-10T11:00:00Z, axes: flu, sampling: mean,
          f: ['c0 [g]', 'c1 [g]', 'c2 [g]'], w: ['c3 [deg/s]', 'c4 [deg/s]', 'c5 [deg/s]']}
  dvl:   {topic: dvl.csv, time: 'ms [ms]', epoch: 2024-09-10T11:00:00Z, axes: flu, v: [u, v, w], valid: lock}
  depth: {topic: ctd.csv, time: 'ms [ms]', epoch: 2024-09-10T11:00:00Z, pressure: 'p [mbar]'}
"""
FLU = np.array([1.0, -1.0, -1.0])


def write_log(dive: Dive, folder: Path) -> None:
    t0 = 1_725_966_000_000_000_000  # 2024-09-10T11:00:00Z
    imu, dvl, depth = dive.imu, dive.dvl, dive.depth
    pressure = 1013.25 + 100.0 * gsw.p_from_z(-depth.depth, 43.0)
    tables = {"xsens.csv": ("ms,c0,c1,c2,c3,c4,c5", imu, [imu.f_s * FLU / 9.80665, np.degrees(imu.w_s) * FLU])}
    tables |= {"dvl.csv": ("ms,u,v,w,lock", dvl, [dvl.v_s * FLU, dvl.valid]), "ctd.csv": ("ms,p", depth, [pressure])}
    for name, (header, stream, columns) in tables.items():
        rows = np.column_stack([(stream.t_ns - t0) * 1e-6, *columns])
        np.savetxt(folder / name, rows, delimiter=",", header=header, comments="", fmt="%.9g")


if __name__ == "__main__":
    truth = simulate(SimulationSettings(duration_s=float(sys.argv[1]) if len(sys.argv) > 1 else 300.0), seed=1)
    with tempfile.TemporaryDirectory() as work:
        write_log(truth, log := Path(work))
        mapping = parse_settings(LogMapping, parse_yaml(MAPPING, "mapping"), "mapping")
        report = import_dive(log, log / "dive", options=LogOptions(mapping))
        print(*(f"{s.name:6} {s.count:6} samples, {s.rate_hz:.4g} Hz" for s in report.streams), sep="\n")
        start = SmoothSettings(heading_deg=float(np.degrees(truth.reference.rph[0, 2])))
        solution = smooth(read_dive(log / "dive"), start)
        print(f"{len(solution)} keyframes, {np.linalg.norm(np.diff(solution.p_n, axis=0), axis=1).sum():.0f} m")
