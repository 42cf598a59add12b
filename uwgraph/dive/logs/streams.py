"""One builder per kind of stream: the mapping's columns, in SI, to our axes, signs and types."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from uwgraph.dive.layout import depth_from_pressure
from uwgraph.dive.logs.axes import turn, turned_attitude, turned_covariance
from uwgraph.dive.logs.headings import HEADINGS
from uwgraph.dive.logs.mapping import (
    AltitudeMapping,
    DepthMapping,
    DvlMapping,
    FixesMapping,
    GravityMapping,
    HeadingMapping,
    ImuMapping,
    ReferenceMapping,
)
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.samples import Samples
from uwgraph.dive.logs.sampling import interval_means
from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.frames import R_n_local, geodetic_from_ned, matrix_from_rph, rph_from_matrix, wrap_pi
from uwgraph.types import (
    Altitude,
    BoolArray,
    Depth,
    Dvl,
    Fixes,
    FloatArray,
    Gravity,
    Heading,
    Imu,
    Origin,
    Reference,
    Stream,
)

FIRST_S: Final = 5.0
"""The air's pressure is the median of so much of the log, where it is to be that of the first samples."""
LEAST_SHARE: Final = 0.005
"""... or this quantile of the dive: an outlier or a wave is not the surface."""


def imu(samples: Samples, mapping: ImuMapping, dive: Dive, notes: Notes) -> Imu:
    f, w = (samples[name] @ turn(mapping.axes).T for name in ("f", "w"))
    if mapping.axes != "frd":
        notes.conversions.append(f"imu: axes {mapping.axes} turned to frd")
    if mapping.sampling == "mean":
        return Imu(samples.t_ns, f, w)
    if len(samples) < 2:
        raise DataError("holds a single sample", where="imu", remedy="is it the right topic?")
    notes.conversions.append(
        "imu: instantaneous samples averaged with their predecessors to interval means; the first one dropped"
    )
    return Imu(samples.t_ns[1:], interval_means(f), interval_means(w))


def dvl(samples: Samples, mapping: DvlMapping, dive: Dive, notes: Notes) -> Dvl:
    valid: BoolArray = np.all(np.isfinite(samples["v"]), axis=1)
    if "valid" in samples:
        flag = samples["valid"]
        valid &= np.isfinite(flag) & (flag != 0.0 if mapping.valid_above is None else flag > mapping.valid_above)
    if mapping.axes != "frd":
        notes.conversions.append(f"dvl: axes {mapping.axes} turned to frd")
    if not valid.all():
        notes.conversions.append(f"dvl: {np.count_nonzero(~valid)} of {len(valid)} pings without bottom lock")
    cov = _covariances("dvl", samples, mapping.axes, notes)
    return Dvl(samples.t_ns, samples["v"] @ turn(mapping.axes).T, cov, valid)


def depth(samples: Samples, mapping: DepthMapping, dive: Dive, notes: Notes) -> Depth:
    sigma = _sigma("depth", samples, notes)
    if "depth" in samples:
        return Depth(samples.t_ns, samples["depth"], sigma)
    if "height" in samples:
        notes.conversions.append("depth: minus the height")
        return Depth(samples.t_ns, -samples["height"], sigma)
    air = _surface_pressure(samples, mapping)
    notes.conversions.append(
        f"depth: from pressure (TEOS-10, at the origin's latitude) above {air:.0f} Pa at the surface "
        f"({mapping.surface_pressure_pa if isinstance(mapping.surface_pressure_pa, str) else 'stated'})"
    )
    return Depth(samples.t_ns, depth_from_pressure(samples["pressure"] - air, dive.origin.lat), sigma)


def altitude(samples: Samples, mapping: AltitudeMapping, dive: Dive, notes: Notes) -> Altitude:
    return Altitude(samples.t_ns, samples["altitude"], _sigma("altitude", samples, notes))


def fixes(samples: Samples, mapping: FixesMapping, dive: Dive, notes: Notes) -> Fixes:
    lat, lon, height = _place("fixes", samples, mapping.world, dive.origin, notes)
    cov = _covariances("fixes", samples, mapping.world, notes)
    level = np.isnan(height)
    known = np.isfinite(cov).all(axis=(1, 2))
    cov[level & known, :2, 2] = cov[level & known, 2, :2] = 0.0
    cov[level & known, 2, 2] = np.inf
    return Fixes(samples.t_ns, lat, lon, height, cov, np.full(len(samples), mapping.source))


def heading(samples: Samples, mapping: HeadingMapping, dive: Dive, notes: Notes) -> Heading:
    source = next(name for name in HEADINGS if name in samples)
    samples, angle = HEADINGS[source](samples, mapping, dive, notes)
    if mapping.reference == "magnetic" and dive.rig.heading.declination_deg is None:
        notes.caveats.append("heading: magnetic; set rig.heading.declination_deg before it is used")
    return Heading(samples.t_ns, wrap_pi(angle), _sigma("heading", samples, notes), mapping.reference)


def gravity(samples: Samples, mapping: GravityMapping, dive: Dive, notes: Notes) -> Gravity:
    kind = "gravity" if "gravity" in samples else "anomaly"
    return Gravity(samples.t_ns, samples[kind], samples["sigma"], kind)


def reference(samples: Samples, mapping: ReferenceMapping, dive: Dive, notes: Notes) -> Reference:
    lat, lon, height = _place("reference", samples, mapping.world, dive.origin, notes)
    R_nb = np.full((len(samples), 3, 3), np.nan)
    rph = samples["rph"] if "rph" in samples else np.full((len(samples), 3), np.nan)
    if "orientation" in samples:
        known = np.linalg.norm(samples["orientation"], axis=1) > 0.5
        R_nb[known] = turned_attitude(samples["orientation"][known], mapping.axes, mapping.world)
        R_nb = _local(R_nb, lat, lon, dive.origin) if "position" in samples else R_nb
        rph = rph_from_matrix(R_nb)
        notes.conversions.append(f"reference: attitude of {mapping.axes} against {mapping.world} turned to frd and ned")
    return Reference(samples.t_ns, lat, lon, height, rph, _velocity(samples, mapping, rph, notes))


def _velocity(samples: Samples, mapping: ReferenceMapping, rph: FloatArray, notes: Notes) -> FloatArray:
    if "velocity" not in samples:
        return np.full((len(samples), 3), np.nan)
    if mapping.velocity_in == "world":
        return samples["velocity"] @ turn(mapping.world).T
    v_b = samples["velocity"] @ turn(mapping.axes).T
    v_n = np.full((len(samples), 3), np.nan)
    known = np.isfinite(rph).all(axis=1)
    v_n[known] = np.einsum("nij,nj->ni", matrix_from_rph(rph[known]), v_b[known])
    notes.conversions.append("reference: velocity turned from the body to north, east, down")
    return v_n


def _local(R_n: FloatArray, lat: FloatArray, lon: FloatArray, origin: Origin) -> FloatArray:
    """Attitudes against the map at the origin, against the local NED of their places."""
    R: FloatArray = np.swapaxes(R_n_local(origin, lat, lon), -1, -2) @ R_n
    return R


def _place(
    stream: str, samples: Samples, world: str, origin: Origin, notes: Notes
) -> tuple[FloatArray, FloatArray, FloatArray]:
    if "position" not in samples:
        return samples.get("lat"), samples.get("lon"), samples.get("height")
    notes.conversions.append(f"{stream}: positions on a local {world} map put about the origin")
    return geodetic_from_ned(origin, samples["position"] @ turn(world).T)


def _surface_pressure(samples: Samples, mapping: DepthMapping) -> float:
    pressure = samples["pressure"]
    if mapping.surface_pressure_pa == "first":
        return float(np.median(pressure[samples.t_ns - samples.t_ns[0] <= FIRST_S * 1e9]))
    if mapping.surface_pressure_pa == "least":
        return float(np.quantile(pressure, LEAST_SHARE))
    return float(mapping.surface_pressure_pa)


def _sigma(stream: str, samples: Samples, notes: Notes) -> FloatArray:
    """The 1-sigma, NaN where the log has none; what is not positive is none."""
    sigma = samples.get("sigma").copy()
    none = sigma <= 0.0
    if none.any():
        notes.conversions.append(f"{stream}: {np.count_nonzero(none)} sigmas that are not positive taken as unknown")
    sigma[none] = np.nan
    return sigma


def _covariances(stream: str, samples: Samples, axes: str, notes: Notes) -> FloatArray:
    """Covariances in our axes, NaN where the log has none: all zero, or a negative variance."""
    if "cov" not in samples:
        sigma = _sigma(stream, samples, notes)
        return np.where(np.eye(3, dtype=np.bool_), sigma[:, None, None] ** 2, sigma[:, None, None] * 0.0)
    cov = turned_covariance(samples["cov"], axes)
    cov = 0.5 * (cov + np.swapaxes(cov, 1, 2))
    bad: BoolArray = ~np.all(np.isfinite(cov), axis=(1, 2)) | ~np.any(cov, axis=(1, 2))
    bad[~bad] = np.linalg.eigvalsh(cov[~bad])[:, 0] < 0.0
    if bad.any():
        notes.conversions.append(f"{stream}: {np.count_nonzero(bad)} covariances that say nothing taken as unknown")
    cov[bad] = np.nan
    return cov


Builder = Callable[[Samples, Any, Dive, Notes], Stream]

BUILDERS: Final[Mapping[str, Builder]] = {
    "imu": imu,
    "dvl": dvl,
    "fixes": fixes,
    "reference": reference,
    "depth": depth,
    "altitude": altitude,
    "gravity": gravity,
    "heading": heading,
}
"""In the order in which they are built: a heading needs the IMU, of the dive so far."""
