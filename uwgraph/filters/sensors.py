"""The dive's streams as measurements at their own moments, in the order in which a filter takes them."""

from __future__ import annotations

import gtsam
import numpy as np

import factors
from factors.lie import exp_so3
from uwgraph.frames import R_n_local, ned_from_geodetic
from uwgraph.graph.models import depth_models, fix_models, heading_models, sun_models
from uwgraph.graph.observed import Observed, Role
from uwgraph.graph.place import place_at
from uwgraph.graph.prepare import Prepared
from uwgraph.graph.track import Track
from uwgraph.sun.ephemeris import sun_direction_n
from uwgraph.types import RelativePoses, TimeArray

DVL_ROLES: tuple[Role, ...] = ("pose", "velocity", "bias", "dvl")


def observations(prepared: Prepared, track: Track) -> list[Observed]:
    """Every measurement of a prepared dive that is of one moment; ``track`` says roughly where each was made."""
    each = [*_dvl(prepared), *_depth(prepared, track), *_fixes(prepared), *_heading(prepared, track)]
    return [*each, *_sun(prepared, track)]


def relative(kind: str, stream: RelativePoses) -> list[Observed]:
    """Motions from an earlier pose to the present one: visual odometry, places seen again."""
    return [
        Observed(t, kind, factors.RelativePose(gtsam.Pose3(gtsam.Rot3(R), p), cov), ("node", "pose"), before)
        for t, before, R, p, cov in zip(
            stream.t_ns.tolist(), stream.from_ns.tolist(), exp_so3(stream.rotvec), stream.p, stream.cov, strict=True
        )
    ]


def rememberable(stream: RelativePoses, most: int) -> RelativePoses:
    """As many motions as ``most`` poses remembered at a time allow, those with the shortest wait first."""
    chosen: list[int] = []
    for n in np.argsort(stream.t_ns - stream.from_ns, kind="stable").tolist():
        pending = [k for k in chosen if stream.from_ns[k] < stream.t_ns[n] and stream.t_ns[k] > stream.from_ns[n]]
        if _most_at_once(stream.from_ns[pending], stream.t_ns[pending]) < most:
            chosen.append(n)
    return stream.select(np.sort(chosen).astype(np.intp))


def _most_at_once(begin: TimeArray, end: TimeArray) -> int:
    """Largest number of intervals that overlap at one moment."""
    if not len(begin):
        return 0
    at = np.concatenate([begin, end])
    step = np.repeat([1, -1], len(begin))
    order = np.lexsort((step, at))
    return int(np.cumsum(step[order]).max())


def _dvl(prepared: Prepared) -> list[Observed]:
    dvl = prepared.dvl
    if dvl is None:
        return []
    imu, l_b = prepared.imu, prepared.dive.rig.dvl.l_b
    w_b = imu.w_b[np.clip(np.searchsorted(imu.t_ns, dvl.t_ns) - 1, 0, len(imu.w_b) - 1)]
    return [
        Observed(t, "dvl", factors.DvlVelocity(v, cov, w, l_b, prepared.earth_rate_n), DVL_ROLES)
        for t, v, cov, w in zip(dvl.t_ns.tolist(), dvl.v_b, dvl.cov_b, w_b, strict=True)
    ]


def _depth(prepared: Prepared, track: Track) -> list[Observed]:
    stream = prepared.depth
    if stream is None:
        return []
    place = place_at(prepared, stream.t_ns, track)
    models = depth_models(stream.depth, stream.sigma, place, prepared.dive.rig.depth.l_b)
    return [Observed(t, "depth", model) for t, model in zip(stream.t_ns.tolist(), models, strict=True)]


def _fixes(prepared: Prepared) -> list[Observed]:
    stream, origin = prepared.fixes, prepared.origin
    if stream is None:
        return []
    cov = stream.cov_n.copy()
    cov[~np.isfinite(stream.height), 2, 2] = np.inf
    p_n = ned_from_geodetic(origin, stream.lat, stream.lon, np.nan_to_num(stream.height))
    models = fix_models(p_n, cov, R_n_local(origin, stream.lat, stream.lon), prepared.dive.rig.fixes.l_b)
    return [Observed(t, "fixes", model) for t, model in zip(stream.t_ns.tolist(), models, strict=True)]


def _heading(prepared: Prepared, track: Track) -> list[Observed]:
    stream = prepared.heading
    if stream is None:
        return []
    models = heading_models(stream.heading, stream.sigma, place_at(prepared, stream.t_ns, track))
    return [Observed(t, "heading", model) for t, model in zip(stream.t_ns.tolist(), models, strict=True)]


def _sun(prepared: Prepared, track: Track) -> list[Observed]:
    if prepared.sun is None:
        return []
    stream = prepared.sun.select(prepared.sun.flags == 0)
    if not len(stream):
        return []
    place = place_at(prepared, stream.t_ns, track)
    s_n = sun_direction_n(prepared.origin, stream.t_ns, place.lat, place.lon)
    models = sun_models(stream.information_b, s_n)
    return [Observed(t, "sun", model) for t, model in zip(stream.t_ns.tolist(), models, strict=True)]
