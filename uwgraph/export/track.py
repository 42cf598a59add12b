"""What is exported: poses in time order with what is known about them, whoever made them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from uwgraph.dive.body_reference import body_reference
from uwgraph.dive.layout import Field
from uwgraph.dive.model import Dive
from uwgraph.dive.tables import Table
from uwgraph.errors import DataError
from uwgraph.evaluate.people import congruence, rph_jacobian
from uwgraph.evaluate.table import solution_table
from uwgraph.frames import R_n_local, matrix_from_rph, ned_from_geodetic
from uwgraph.time import NS
from uwgraph.types import BoolArray, FloatArray, Origin, Solution, Stream, stream_fields

_NED: Final = ("north", "east", "down")
_RPH: Final = ("roll_deg", "pitch_deg", "heading_deg")
_V: Final = ("v_n", "v_e", "v_d")
_GYRO: Final = ("bias_gyro_x", "bias_gyro_y", "bias_gyro_z")
_ACCEL: Final = ("bias_accel_x", "bias_accel_y", "bias_accel_z")


def _sigma(names: tuple[str, ...], *, degrees: bool = False) -> Field:
    return Field(tuple(f"sigma_{name}" for name in names), degrees=degrees)


COLUMNS: Final[Mapping[str, Field]] = {
    "t_ns": Field(("t_ns",), "int"),
    "lat": Field(("lat_deg",), degrees=True),
    "lon": Field(("lon_deg",), degrees=True),
    "height": Field(("height",)),
    "p_n": Field(_NED),
    "sigma_p": _sigma(_NED),
    "rph": Field(_RPH, degrees=True),
    "sigma_rph": _sigma(_RPH, degrees=True),
    "v_n": Field(_V),
    "sigma_v": _sigma(_V),
    "bias_gyro": Field(_GYRO),
    "sigma_bias_gyro": _sigma(_GYRO),
    "bias_accel": Field(_ACCEL),
    "sigma_bias_accel": _sigma(_ACCEL),
    "cov_p": Field(("cov_north_east", "cov_north_down", "cov_east_down")),
}
"""Field of a track, and its columns in ``solution.parquet``."""


@dataclass(frozen=True, eq=False)
class Track(Stream):
    """Poses of the body (FRD) in time order; NaN where a quantity is not known."""

    lat: FloatArray
    """Geodetic latitude, shape (K,), rad."""
    lon: FloatArray
    """Longitude, shape (K,), rad."""
    height: FloatArray
    """Above the sea surface, shape (K,), m."""
    p_n: FloatArray
    """Position in n, shape (K, 3), m; NaN where the height is not known."""
    sigma_p: FloatArray
    """1-sigma of ``p_n``, shape (K, 3), m."""
    rph: FloatArray
    """Roll, pitch, heading against the local vertical and true north, shape (K, 3), rad."""
    sigma_rph: FloatArray
    """1-sigma of ``rph``, shape (K, 3), rad."""
    v_n: FloatArray
    """Velocity over the ground in n, shape (K, 3), m/s."""
    sigma_v: FloatArray
    """1-sigma of ``v_n``, shape (K, 3), m/s."""
    bias_gyro: FloatArray
    """In the body frame, shape (K, 3), rad/s."""
    sigma_bias_gyro: FloatArray
    """1-sigma of ``bias_gyro``, shape (K, 3), rad/s."""
    bias_accel: FloatArray
    """In the body frame, shape (K, 3), m/s^2."""
    sigma_bias_accel: FloatArray
    """1-sigma of ``bias_accel``, shape (K, 3), m/s^2."""
    cov_p: FloatArray
    """Covariances north-east, north-down and east-down of ``p_n``, shape (K, 3), m^2."""
    origin: Origin
    name: str
    """``solution`` or ``reference``: what people and programs find it by."""

    @classmethod
    def scalars(cls) -> tuple[str, ...]:
        return ("origin", "name")

    @cached_property
    def R_n_local(self) -> FloatArray:
        """Rotation from the local north, east, down to n, shape (K, 3, 3)."""
        return R_n_local(self.origin, self.lat, self.lon)

    @cached_property
    def R_nb(self) -> FloatArray:
        """Rotation body to navigation, shape (K, 3, 3)."""
        R: FloatArray = self.R_n_local @ matrix_from_rph(self.rph)
        return R

    @property
    def cov_p_n(self) -> FloatArray:
        """Covariance of ``p_n``, shape (K, 3, 3), m^2."""
        cov = self.sigma_p[:, :, None] ** 2 * np.eye(3)
        for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
            cov[:, i, j] = cov[:, j, i] = self.cov_p[:, k]
        return cov

    @property
    def placed(self) -> BoolArray:
        """Where latitude and longitude are known, shape (K,)."""
        return np.isfinite(self.lat) & np.isfinite(self.lon)

    @property
    def posed(self) -> BoolArray:
        """Where position and attitude are all known, shape (K,)."""
        return np.asarray(np.isfinite(self.p_n).all(axis=1) & np.isfinite(self.rph).all(axis=1))


def track_of_table(table: Table, origin: Origin, name: str) -> Track:
    """The track of the columns of ``solution.parquet``."""
    return Track(**{key: field.read(table) for key, field in COLUMNS.items()}, origin=origin, name=name)


def table_of_track(track: Track) -> Table:
    """The columns of a track in people's units; those that are not known anywhere are left out."""
    table: Table = {}
    for key, array in stream_fields(track):
        table |= COLUMNS[key].write(array)
    return {name: column for name, column in table.items() if column.dtype.kind != "f" or np.isfinite(column).any()}


def track_of_solution(solution: Solution) -> Track:
    """A solution that has just been computed; that of a folder is read by ``read_result``."""
    columns = solution_table(solution)
    table = {name: columns.column(name).to_numpy() for name in columns.column_names}
    return track_of_table(table, solution.origin, "solution")


def solution_of_track(track: Track) -> Solution:
    """The states of a track that knows them all, as a solution whose errors of roll, pitch and heading are independent.

    A file has no more than their 1-sigma, and nothing of the covariance between position, velocity and attitude.
    """
    R = track.R_nb
    to_angles = rph_jacobian(track.rph) @ matrix_from_rph(track.rph)
    cov_pose = np.zeros((len(track), 6, 6))
    from_angles = np.linalg.inv(to_angles).astype(np.float64)
    cov_pose[:, :3, :3] = congruence(from_angles, track.sigma_rph[:, :, None] ** 2 * np.eye(3))
    cov_pose[:, 3:, 3:] = congruence(np.swapaxes(R, 1, 2), track.cov_p_n)
    sigma_bias = np.hstack([track.sigma_bias_accel, track.sigma_bias_gyro])
    return Solution(
        origin=track.origin,
        t_ns=track.t_ns,
        R_nb=R,
        p_n=track.p_n,
        v_n=track.v_n,
        bias_gyro=track.bias_gyro,
        bias_accel=track.bias_accel,
        cov_pose=cov_pose,
        cov_v=track.sigma_v[:, :, None] ** 2 * np.eye(3),
        cov_bias=sigma_bias[:, :, None] ** 2 * np.eye(6),
    )


def track_of_reference(dive: Dive) -> Track:
    """The dive's reference, brought to the body's origin and the dive's clock as the rig says.

    Raises
    ------
    DataError
        When the dive has none, or one that is nowhere.
    """
    reference = body_reference(dive)
    if reference is None:
        raise DataError(
            "the dive has no reference",
            where="reference",
            remedy="smooth the dive and export the result; --stream fixes exports its fixes, .mcap its sensors",
        )
    unknown = np.full((len(reference), 3), np.nan)
    R = R_n_local(dive.origin, reference.lat, reference.lon)
    track = Track(
        t_ns=reference.t_ns,
        lat=reference.lat,
        lon=reference.lon,
        height=reference.height,
        p_n=ned_from_geodetic(dive.origin, reference.lat, reference.lon, reference.height),
        rph=np.column_stack([reference.rph[:, :2], reference.rph[:, 2] % (2.0 * np.pi)]),
        v_n=np.einsum("kij,kj->ki", R, reference.v_n),
        bias_gyro=unknown,
        bias_accel=unknown,
        **dict.fromkeys(("sigma_p", "sigma_rph", "sigma_v", "sigma_bias_gyro", "sigma_bias_accel", "cov_p"), unknown),
        origin=dive.origin,
        name="reference",
    )
    if not track.placed.any():
        raise DataError("the reference knows no position", where="reference", remedy="smooth the dive, export that")
    return track


def thinned(track: Track, rate_hz: float) -> Track:
    """At most so many poses a second: the first of each period; nothing is interpolated."""
    period = (track.t_ns - track.t_ns[0]) // max(round(NS / rate_hz), 1)
    return track.select(np.concatenate([[True], np.diff(period) > 0]))
