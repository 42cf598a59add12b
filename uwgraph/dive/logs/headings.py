"""Headings out of what logs have instead: angles of other conventions, orientations, magnetic fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from uwgraph.dive.logs.axes import turn, turned_attitude
from uwgraph.dive.logs.mapping import HeadingMapping
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.samples import Samples
from uwgraph.dive.model import Dive
from uwgraph.dive.vertical import vertical
from uwgraph.errors import DataError
from uwgraph.frames import rph_from_matrix
from uwgraph.types import FloatArray

MIN_HORIZONTAL: Final = 1e-3
"""Share of the field that must be level for it to point anywhere."""

_Found = tuple[Samples, FloatArray]


def from_angle(samples: Samples, mapping: HeadingMapping, dive: Dive, notes: Notes) -> _Found:
    angle = samples["heading"]
    if mapping.world == "ned":
        return samples, angle
    notes.conversions.append(f"heading: from an angle that counts anticlockwise from the x axis of {mapping.world}")
    return samples, (np.pi / 2 if mapping.world == "enu" else 0.0) - angle


def from_orientation(samples: Samples, mapping: HeadingMapping, dive: Dive, notes: Notes) -> _Found:
    R_nb = turned_attitude(samples["orientation"], mapping.axes, mapping.world)
    notes.conversions.append(f"heading: of the attitude of {mapping.axes} against {mapping.world}")
    return samples, rph_from_matrix(R_nb)[:, 2]


def from_magnetic_field(samples: Samples, mapping: HeadingMapping, dive: Dive, notes: Notes) -> _Found:
    """The field in the body, levelled by the vertical that the IMU knows."""
    if dive.imu is None:
        raise DataError(
            "a magnetic field gives a heading only with an IMU, which says what is level",
            where="heading: magnetic_field",
            remedy="map an imu stream too, or take the heading out of the mapping",
        )
    start, end = dive.imu.t_ns[[0, -1]] + dive.rig.imu.time_offset_ns
    samples = samples.take((samples.t_ns >= start) & (samples.t_ns <= end))
    up = vertical(dive, samples.t_ns).up_b
    m_b = samples["magnetic_field"] @ turn(mapping.axes).T
    level = m_b - np.sum(m_b * up, axis=1)[:, None] * up
    size = np.linalg.norm(level, axis=1)
    good = size > MIN_HORIZONTAL * np.linalg.norm(m_b, axis=1)
    samples, up, north = samples.take(good), up[good], level[good] / size[good, None]
    east = np.cross(north, up)
    notes.conversions.append(f"heading: magnetic field of axes {mapping.axes}, levelled by the IMU's vertical")
    notes.caveats.append("heading: from a magnetometer whose hard and soft iron errors are not removed")
    return samples, np.arctan2(east[:, 0], north[:, 0])


HEADINGS: Final[Mapping[str, Callable[[Samples, HeadingMapping, Dive, Notes], _Found]]] = {
    "heading": from_angle,
    "orientation": from_orientation,
    "magnetic_field": from_magnetic_field,
}
