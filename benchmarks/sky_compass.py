"""A polarization compass of photodiodes on a turning robot: calibrated on some turns, judged on others.

    python benchmarks/sky_compass.py DATA [--calibrate clear_1 clear_2 clear_3] [--test clear_4 clear_5 clear_6]
        [--also canopy_1 ...] [--place LAT LON] [--at RUN=2022-05-12T14:02:44 ...] [--plot DIR] [--json] [--save]

DATA holds ROS 1 bags with the topics ``yaw`` (Float64, rad, counter-clockwise, from the robot's odometry) and, unit by
unit, ``pol_op_0``, ... (Int32MultiArray: one count for each photodiode; the sign carries nothing). The polarizer angles
of every unit are those of ``--polarizers``, from any zero and in either sense. Times are those at which the bag got its
messages, UTC, or start at what ``--at`` says.

The error is the heading from the sun less the robot's yaw, less one constant for each run. The units are read in turn,
each about twice a second, and the topics repeat what was read last. In the table ``carried``, each unit's reading is
carried from when it first appeared to the sample by the robot's yaw in between (half a second, 6 deg at most; a gyro
would do as well); in ``held`` it is taken for that of the sample. The limits are those of ``carried``.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

from _bench import Figure, Row, finish, parser

# isort: split
import matplotlib as mpl
import numpy as np
from rosbags.highlevel import AnyReader

from uwgraph.frames import wrap_pi
from uwgraph.sun import sun_azimuth_elevation
from uwgraph.sun.observation import SunObservation
from uwgraph.sun.polarimeter import Polarimeter, Readings, observe
from uwgraph.sun.polarimeter_calibration import Calibration, calibrate
from uwgraph.types import BoolArray, FloatArray

PLACE = (39.258648, 8.440184)  # Sardinia, where the recordings named below were made
CALIBRATE = ("clear_1", "clear_2", "clear_3")
TEST = ("clear_4", "clear_5", "clear_6")
POLARIZERS = (135.0, 45.0, 90.0, 0.0)


@dataclass(frozen=True)
class Judged:
    """A run, sample by sample."""

    run: str
    yaw: FloatArray
    error: FloatArray
    """Heading less yaw less the run's constant, rad; NaN where there was no heading."""
    sigma: FloatArray
    ok: BoolArray
    constant: float
    zenith_error: FloatArray

    def row(self) -> Row:
        e, sigma = np.degrees(self.error[self.ok]), np.degrees(self.sigma[self.ok])
        some = len(e) > 0
        return {
            "run": self.run,
            "samples": len(self.ok),
            "refused_%": 100.0 * float(np.mean(~self.ok)),
            "median_deg": float(np.median(np.abs(e))) if some else float("nan"),
            "rmse_deg": float(np.sqrt(np.mean(e**2))) if some else float("nan"),
            "largest_deg": float(np.abs(e).max()) if some else float("nan"),
            "sigma_deg": float(np.median(sigma)) if some else float("nan"),
            "nees": float(np.mean((e / sigma) ** 2)) if some else float("nan"),
            "within_2_sigma_%": 100.0 * float(np.mean(np.abs(e) < 2.0 * sigma)) if some else float("nan"),
            "zenith_error_deg": float(np.degrees(np.median(self.zenith_error[self.ok]))) if some else float("nan"),
            "constant_deg": float(np.degrees(self.constant)),
        }


def readings(bag: Path, place: tuple[float, float], start: np.datetime64 | None) -> Readings:
    """The counts, the yaw and the almanac's sun of one bag."""
    if not bag.is_file():
        sys.exit(f"error: {bag} is not there")
    stamps: list[int] = []
    yaw: list[float] = []
    units: dict[str, list[FloatArray]] = {}
    with AnyReader([bag]) as reader:
        for connection, stamp, raw in reader.messages():
            topic = connection.topic.strip("/")
            if topic == "yaw":
                stamps.append(stamp)
                yaw.append(float(reader.deserialize(raw, connection.msgtype).data))  # type: ignore[attr-defined]
            elif topic.startswith("pol_op_"):
                data = reader.deserialize(raw, connection.msgtype).data  # type: ignore[attr-defined]
                units.setdefault(topic, []).append(np.abs(np.asarray(data, dtype=np.float64)))
    if not yaw or not units:
        sys.exit(f"error: {bag} lacks the topic yaw or the topics pol_op_0, pol_op_1, ...")
    samples = min(len(yaw), *(len(u) for u in units.values()))
    t_ns = np.array(stamps[:samples], dtype=np.int64)
    if start is not None:
        t_ns = t_ns - t_ns[0] + start.astype("datetime64[ns]").astype(np.int64)
    azimuth, elevation = sun_azimuth_elevation(t_ns, *np.radians(place))
    ordered = sorted(units, key=lambda topic: int(topic.rsplit("_", 1)[1]))
    counts = np.stack([np.array(units[topic][:samples]) for topic in ordered], axis=1)
    return Readings(t_ns, counts, -np.unwrap(yaw[:samples]), azimuth, np.pi / 2.0 - elevation)


def judged(run: str, compass: Polarimeter, turn: Readings, carried: bool) -> Judged:
    turned = turn.turned if carried else np.zeros_like(turn.turned)
    found = [
        observe(compass, counts, t, sun_zenith=zenith)
        for counts, t, zenith in zip(turn.counts, turned, turn.sun_zenith, strict=True)
    ]
    ok = np.array([o.ok for o in found])
    error = np.array([o.heading(azimuth) for o, azimuth in zip(found, turn.sun_azimuth, strict=True)]) - turn.yaw
    constant = _middle(error[ok])
    return Judged(
        run,
        turn.yaw,
        wrap_pi(error - constant),
        np.array([o.azimuth_sigma for o in found]),
        ok,
        constant,
        np.array([_zenith(o) for o in found]) - turn.sun_zenith,
    )


def _zenith(o: SunObservation) -> float:
    return np.pi / 2.0 - o.elevation


def _middle(angles: FloatArray) -> float:
    """Median on the circle."""
    if not len(angles):
        return float("nan")
    about = float(np.angle(np.exp(1j * angles).mean()))
    return float(wrap_pi(about + np.median(wrap_pi(angles - about))))


def pooled(runs: list[Judged]) -> Row:
    joined = {name: np.concatenate([getattr(r, name) for r in runs]) for name in ("yaw", "error", "sigma", "ok")}
    return Judged(
        "all", **joined, constant=float("nan"), zenith_error=np.concatenate([r.zenith_error for r in runs])
    ).row()


def unit_rows(found: Calibration) -> list[Row]:
    compass = found.polarimeter
    rows: list[Row] = []
    for u, d in enumerate(compass.directions_b):
        on = bool(compass.in_use[u])
        rows.append(
            {
                "unit": u,
                "azimuth_deg": float(np.degrees(np.arctan2(d[1], d[0]))) if on else float("nan"),
                "elevation_deg": float(np.degrees(np.arcsin(-d[2]))) if on else float("nan"),
                "gains": " ".join(
                    f"{g:.3f}" if k else "-" for g, k in zip(compass.gains[u], compass.good[u], strict=True)
                ),
                "error_%": 100.0 * float(compass.error[u]),
                "found": found.notes[u] or "sound",
            }
        )
    return rows


def plot(folder: Path, runs: list[Judged]) -> None:
    """One picture of all runs: error and 2 sigma against the robot's yaw."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(len(runs), 1, figsize=(9, 1.0 + 1.8 * len(runs)), sharex=True, squeeze=False)
    for axis, run in zip(axes[:, 0], runs, strict=True):
        yaw, error, sigma = np.degrees(run.yaw), np.degrees(run.error), np.degrees(run.sigma)
        axis.fill_between(yaw, -2.0 * sigma, 2.0 * sigma, where=run.ok, color="0.88", label="2 sigma")
        axis.plot(yaw[run.ok], error[run.ok], ".", ms=3, label="error")
        axis.plot(yaw[~run.ok], error[~run.ok], "x", ms=4, color="tab:red", label="refused")
        axis.set_ylim(-5.0, 5.0)
        axis.set_ylabel(f"{run.run}\ndeg")
        axis.grid(visible=True, alpha=0.4)
    axes[0, 0].legend(loc="upper right", ncols=3, fontsize=8)
    axes[-1, 0].set_xlabel("yaw, deg clockwise")
    figure.tight_layout()
    figure.savefig(folder / "sky_compass.png", dpi=110)


def main() -> None:
    args = arguments()
    starts = dict(item.split("=", 1) for item in args.at)

    def turn(run: str) -> Readings:
        start = np.datetime64(starts[run].removesuffix("Z")) if run in starts else None
        return readings(args.data / f"{run}.bag", tuple(args.place), start)

    calibrating = [turn(run) for run in args.calibrate]
    shape = calibrating[0].counts.shape[1:]
    if len(args.polarizers) != shape[1]:
        sys.exit(f"error: {shape[1]} photodiodes a unit and {len(args.polarizers)} angles: give --polarizers")
    found = calibrate(calibrating, np.broadcast_to(np.radians(args.polarizers), shape))
    runs = {run: turn(run) for run in [*args.test, *args.also]}
    carried = [judged(run, found.polarimeter, r, carried=True) for run, r in runs.items()]
    held = [judged(run, found.polarimeter, r, carried=False) for run, r in runs.items()]
    tested = pooled(carried[: len(args.test)])
    if args.plot:
        plot(args.plot, carried)
    finish(
        args,
        "sky_compass",
        {
            "units": unit_rows(found),
            "carried": [*(r.row() for r in carried), tested | {"run": "all of --test"}],
            "held": [*(r.row() for r in held), pooled(held[: len(args.test)]) | {"run": "all of --test"}],
        },
        [
            Figure("median heading error, deg", tested["median_deg"], 1.5),
            Figure("heading RMSE, deg", tested["rmse_deg"], 3.0),
            Figure("samples refused, %", tested["refused_%"], 5.0),
        ],
    )


def arguments() -> Namespace:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--calibrate", nargs="+", default=CALIBRATE, metavar="RUN")
    options.add_argument("--test", nargs="+", default=TEST, metavar="RUN")
    options.add_argument("--also", nargs="+", default=(), metavar="RUN", help="reported as they are, without a limit")
    options.add_argument("--place", nargs=2, type=float, default=PLACE, metavar=("LAT", "LON"), help="deg")
    options.add_argument("--at", nargs="+", default=(), metavar="RUN=UTC", help="start of a run whose clock was wrong")
    options.add_argument("--polarizers", nargs="+", type=float, default=POLARIZERS, metavar="DEG")
    options.add_argument("--plot", type=Path, metavar="DIR")
    return options.parse_args()


if __name__ == "__main__":
    main()
