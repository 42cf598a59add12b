"""Simulated sensors and worse inertial sensors on a real dive.

What is added is derived from the dive's reference (or, for :func:`degrade_imu`, from its own samples) and is written
down under ``provenance["simulated"]``: a result that rests on it is not a result of the recording alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.rig import HeadingRig
from uwgraph.errors import DataError
from uwgraph.simulate.closures import ClosureModel, OdometryModel, measure_closures, measure_odometry
from uwgraph.simulate.imu import GradeName, ImuGrade, add_noise, grade_of, imu_errors, with_errors
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.replay import ReferenceMotion
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


def degrade_imu(dive: Dive, grade: GradeName | ImuGrade = "mems", seed: int = 0) -> Dive:
    """The dive with the errors of a worse IMU added to its own; the rig then states both together.

    Raises
    ------
    DataError
        When the dive has no IMU or its stamps do not increase.
    """
    grade = grade_of(grade)
    if dive.imu is None or len(dive.imu) < 2:
        raise DataError("the dive has no IMU samples to degrade", where="imu", remedy="add imu.parquet")
    dt = np.diff(dive.imu.t_ns) * 1e-9
    if (dt <= 0.0).any():
        raise DataError(
            f"the stamps do not increase after sample {np.flatnonzero(dt <= 0.0)[0]}",
            where="imu.t_ns",
            remedy="remove the repeated or backward samples",
        )
    typical = float(np.median(dt))
    errors = imu_errors(grade, np.concatenate([[typical], dt]), Noise.of(seed, "imu", silent=grade.ideal))
    stated = grade.stated(1.0 / typical)
    what = f"errors added to the recorded samples: {stated.model_dump_json(exclude_defaults=True)}"
    return _with(
        dive,
        "imu",
        with_errors(dive.imu, errors, grade),
        add_noise(dive.rig.imu, stated.model_dump()),
        f"{what}, seed {seed}",
    )


def add_sun_heading(dive: Dive, sigma_deg: float = 0.5, rate_hz: float = 1.0, seed: int = 0) -> Dive:
    """The dive with true headings as the sun would give them, of white noise ``sigma_deg`` (1-sigma).

    Raises
    ------
    DataError
        As :meth:`ReferenceMotion.of`; so do all ``add_...`` functions.
    """
    model = HeadingModel(rig=HeadingRig(sigma_deg=sigma_deg), rate_hz=rate_hz)
    heading = measure_heading(ReferenceMotion.of(dive), model, Noise.of(seed, "heading"))
    return _with(dive, "heading", heading, model.rig, _from_reference("sun heading", seed))


def add_sun(dive: Dive, model: SunModel | None = None, seed: int = 0) -> Dive:
    """The dive with sun directions at its own place and time of day."""
    model = model or SunModel()
    sun = measure_sun(ReferenceMotion.of(dive), model, Noise.of(seed, "sun"))
    return _with(dive, "sun", sun, model.rig, _from_reference("sun direction", seed))


def add_dvl(dive: Dive, model: DvlModel | None = None, seed: int = 0) -> Dive:
    """The dive with velocities over the ground."""
    model = model or DvlModel()
    errors = DvlErrors.draw(model.rig, Noise.of(seed, "dvl calibration"))
    dvl = measure_dvl(ReferenceMotion.of(dive), model, errors, Noise.of(seed, "dvl"))
    return _with(dive, "dvl", dvl, model.rig, _from_reference("velocity", seed))


def add_depth(dive: Dive, model: DepthModel | None = None, seed: int = 0) -> Dive:
    """The dive with depths (negative above the surface)."""
    model = model or DepthModel()
    depth = measure_depth(ReferenceMotion.of(dive), model, Noise.of(seed, "depth"))
    return _with(dive, "depth", depth, model.rig, _from_reference("depth", seed))


def add_fixes(dive: Dive, model: GnssModel | None = None, seed: int = 0) -> Dive:
    """The dive with position fixes while the antenna is above the water; a DataError when it never is."""
    model = model or GnssModel()
    fixes = measure_fixes(ReferenceMotion.of(dive), model, Noise.of(seed, "gnss"))
    if not len(fixes):
        raise DataError(
            "the antenna is under water during the whole reference, where no satellite is heard",
            where="reference.height",
            remedy="add fixes to a dive that surfaces",
        )
    return _with(dive, "fixes", fixes, model.rig, _from_reference("position at the surface", seed))


def add_closures(dive: Dive, model: ClosureModel | None = None, seed: int = 0) -> Dive:
    """The dive with places seen again, some falsely if the model says so; a DataError where it never comes back."""
    model = model or ClosureModel()
    closures = measure_closures(ReferenceMotion.of(dive), model, Noise.of(seed, "closures"))
    how = _from_reference(f"places seen again, {model.false_share:.0%} of them false,", seed)
    return _with(dive, "closures", closures, model.rig, how, rig_name="visual")


def add_odometry(dive: Dive, model: OdometryModel | None = None, seed: int = 0) -> Dive:
    """The dive with visual odometry."""
    model = model or OdometryModel()
    odometry = measure_odometry(ReferenceMotion.of(dive), model, Noise.of(seed, "odometry"))
    return _with(dive, "odometry", odometry, model.rig, _from_reference("visual odometry", seed), rig_name="visual")


def _from_reference(what: str, seed: int) -> str:
    return f"{what} from the reference with the rig's noise, seed {seed}"


def _with(dive: Dive, name: str, stream: Any, rig: Any, how: str, rig_name: str | None = None) -> Dive:
    """The dive with one stream and its rig entry replaced, and the provenance saying so."""
    simulated = {**dive.provenance.get("simulated", {}), name: f"simulated: {how}"}
    return replace(
        dive,
        rig=dive.rig.model_copy(update={rig_name or name: rig}),
        provenance={**dive.provenance, "simulated": simulated},
        **{name: stream},
    )
