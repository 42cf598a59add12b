"""A whole simulated dive: every stream from one truth, with a rig that states the noise that was drawn."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

import numpy as np
from pydantic import AwareDatetime, Field

from uwgraph.dive import Dive, Rig
from uwgraph.dive.rig import DepthRig, DvlRig, FixesRig, HeadingRig, Positive, SunRig
from uwgraph.frames import R_n_local, geodetic_from_ned, rph_from_matrix
from uwgraph.simulate.imu import GradeName, ImuGrade, grade_of, ideal_imu, imu_errors, with_errors
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.plan import Mission, plan
from uwgraph.simulate.sensors import (
    DepthModel,
    DvlErrors,
    DvlModel,
    GnssModel,
    HeadingModel,
    SunModel,
    measure_depth,
    measure_dvl,
    measure_fixes,
    measure_heading,
    measure_sun,
)
from uwgraph.simulate.trajectory import Motion, Trajectory
from uwgraph.time import from_datetime, from_seconds
from uwgraph.types import FloatArray, Origin, Reference


class SimulationSettings(Mission):
    """A mission, where and when it takes place, and what the vehicle carries (``None``: not on board)."""

    lat_deg: Annotated[float, Field(ge=-89.0, le=89.0)] = 43.0
    lon_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 7.5
    start: AwareDatetime = datetime(2024, 9, 10, 11, 0, tzinfo=UTC)
    grade: GradeName | ImuGrade = "mems"
    imu_rate_hz: Positive = 100.0
    truth_rate_hz: Positive = 10.0
    dvl: DvlModel | None = DvlModel()
    depth_sensor: DepthModel | None = DepthModel()
    gnss: GnssModel | None = GnssModel()
    sun: SunModel | None = SunModel()
    compass: HeadingModel | None = None


def simulate(settings: SimulationSettings | None = None, seed: int = 0) -> Dive:
    """The dive that ``settings`` ask for (default: a 20-minute lawn mower), the same for the same seed.

    ``reference`` is the truth; ``provenance["drawn"]`` holds what the random generator gave the sensors for good.

    Raises
    ------
    ConfigError
        When the mission cannot be flown.
    DataError
        When a sun sensor is asked for at night.
    """
    settings = settings or SimulationSettings()
    motion = trajectory_of(settings, seed)
    grade = grade_of(settings.grade)

    def noise(sensor: str) -> Noise:
        return Noise.of(seed, sensor, silent=grade.ideal)

    ideal = ideal_imu(motion, grade.rig, settings.imu_rate_hz)
    errors = imu_errors(grade, np.full(len(ideal), 1.0 / settings.imu_rate_hz), noise("imu"))
    drawn: dict[str, Any] = {"gyro_bias": errors.gyro_bias[0].tolist(), "accel_bias": errors.accel_bias[0].tolist()}
    dvl = None
    if settings.dvl is not None:
        dvl_errors = DvlErrors.draw(settings.dvl.rig, noise("dvl calibration"))
        drawn |= {"dvl_scale": dvl_errors.scale, "dvl_misalignment": dvl_errors.misalignment.tolist()}
        dvl = measure_dvl(motion, settings.dvl, dvl_errors, noise("dvl"))
    return Dive(
        origin=motion.origin,
        rig=_rig(settings, grade),
        imu=with_errors(ideal, errors, grade),
        dvl=dvl,
        depth=None if settings.depth_sensor is None else measure_depth(motion, settings.depth_sensor, noise("depth")),
        fixes=None if settings.gnss is None else measure_fixes(motion, settings.gnss, noise("gnss")) or None,
        heading=None if settings.compass is None else measure_heading(motion, settings.compass, noise("compass")),
        sun=None if settings.sun is None else measure_sun(motion, settings.sun, noise("sun")),
        reference=truth(motion, settings.truth_rate_hz),
        provenance={
            "source": "simulated",
            "seed": seed,
            "settings": settings.model_dump(mode="json"),
            "drawn": drawn,
        },
    )


def trajectory_of(settings: SimulationSettings, seed: int) -> Trajectory:
    """The truth behind :func:`simulate`."""
    origin = Origin(lat=float(np.radians(settings.lat_deg)), lon=float(np.radians(settings.lon_deg)))
    return plan(settings, origin, from_datetime(settings.start), Noise.of(seed, "motion").rng)


def truth(motion: Motion, rate_hz: float) -> Reference:
    """The motion as a reference stream, in people's frames."""
    t: FloatArray = np.arange(int(np.floor(motion.duration_s * rate_hz + 1e-9)) + 1) / rate_hz
    lat, lon, height = geodetic_from_ned(motion.origin, motion.position(t))
    R_ln = np.swapaxes(R_n_local(motion.origin, lat, lon), -1, -2)
    return Reference(
        from_seconds(t, motion.start_ns),
        lat=lat,
        lon=lon,
        height=height,
        rph=rph_from_matrix(R_ln @ motion.attitude(t)),
        v_n=np.einsum("nij,nj->ni", R_ln, motion.velocity(t)),
    )


def _rig(settings: SimulationSettings, grade: ImuGrade) -> Rig:
    return Rig(
        imu=grade.stated(settings.imu_rate_hz),
        dvl=settings.dvl.rig if settings.dvl else DvlRig(),
        depth=settings.depth_sensor.rig if settings.depth_sensor else DepthRig(),
        fixes=settings.gnss.rig if settings.gnss else FixesRig(),
        heading=settings.compass.rig if settings.compass else HeadingRig(),
        sun=settings.sun.rig if settings.sun else SunRig(),
    )
