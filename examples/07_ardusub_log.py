"""An ArduSub log with a DVL: the telemetry of a dive, imported without a word about its messages, and smoothed.

    python examples/07_ardusub_log.py [seconds]

The dive is simulated and written with pymavlink as a ground station would log it (``pip install 'uwgraph[ardusub]'``).
"""

from __future__ import annotations

import struct
import sys
import tempfile
from pathlib import Path

import gsw
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.graph import smooth
from uwgraph.simulate import SimulationSettings, simulate

NONE = (0.0,) * 7


def messages(dive: Dive) -> list[tuple[int, mavlink.MAVLink_message]]:
    """Stamps in ns and messages, in the order of time; the vehicle was started a minute before the dive."""
    imu, dvl, depth, truth = dive.imu, dive.dvl, dive.depth, dive.reference
    boot = imu.t_ns[0] - 60_000_000_000
    lat, lon = (round(np.degrees(angle) * 1e7) for angle in (dive.origin.lat, dive.origin.lon))
    hpa = 1013.25 + 100.0 * gsw.p_from_z(-depth.depth, np.degrees(dive.origin.lat))

    def each(t_ns: np.ndarray, unit: int, name: str, rows: list, *rest: float) -> list:
        make = getattr(mavlink, f"MAVLink_{name}_message")
        return [(t, make((t - boot) // unit, *row, *rest)) for t, row in zip(t_ns.tolist(), rows, strict=True)]

    found = [(t, mavlink.MAVLink_heartbeat_message(12, 3, 81, 19, 4, 3)) for t in depth.t_ns[::10].tolist()]
    found += each(imu.t_ns[:1], 1000, "gps_raw_int", [(3, lat, lon)], 0, 99, 99, 0, 0, 9)
    found += each(imu.t_ns, 1000, "highres_imu", np.hstack([imu.f_s, imu.w_s]).tolist(), *NONE, 63)
    found += each(depth.t_ns, 1_000_000, "scaled_pressure2", hpa[:, None].tolist(), 0.0, 1200)
    found += each(truth.t_ns, 1_000_000, "attitude", truth.rph.tolist(), *NONE[:3])
    found += each(dvl.t_ns, 1000, "vision_position_delta", [(10**6, NONE[:3], v) for v in dvl.v_s.tolist()], 100.0)
    return sorted(found, key=lambda stamped: stamped[0])


if __name__ == "__main__":
    dive = simulate(SimulationSettings(duration_s=float(sys.argv[1]) if len(sys.argv) > 1 else 300.0, grade="mems"), 1)
    vehicle, link = mavlink.MAVLink(None, 1, 1), np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as work:
        log, folder = Path(work, "dive.tlog"), Path(work, "dive")
        with log.open("wb") as file:
            for t_ns, message in messages(dive):
                file.write(struct.pack(">Q", t_ns // 1000 + int(link.exponential(5000.0))) + message.pack(vehicle))
        for taken in import_dive(log, folder).taken:
            print(f"{taken.stream:9} from {taken.topic:22} {taken.note}")
        solution = smooth(read_dive(folder))
        print(f"{len(solution)} keyframes, 1-sigma at the end {np.sqrt(np.trace(solution.cov_pose[-1, 3:, 3:])):.2f} m")
