"""The kinematic filter's answer to a task: its position and heading, on the attitude of dead reckoning."""

from __future__ import annotations

import numpy as np

from uwgraph.filters.estimate import Task
from uwgraph.filters.kinematic import PSI, VEHICLE, Inputs, turned
from uwgraph.filters.reduced import reduced
from uwgraph.filters.run import innovations_of
from uwgraph.filters.settings import FilterSettings
from uwgraph.filters.slam import Slam, SlamResult, SlamSettings
from uwgraph.frames import matrix_from_rph, rph_from_matrix
from uwgraph.types import Innovations, Solution

STANDARD_GRAVITY = 9.80665


def kinematic_estimate(task: Task, settings: FilterSettings) -> tuple[Solution, Innovations | None]:
    """Filter a dive by the kinematic model, adapting to its sensors.

    Between pings dead reckoning moves the last estimate on. Roll and pitch are dead reckoning's, and as sure as the
    accelerometer's bias lets gravity tell.

    Raises
    ------
    DataError
        When there is no Doppler log after the first state.
    """
    small = reduced(task.prepared, task.initial)
    asked = SlamSettings(
        inputs=small.noise, sigma_points=settings.sigma_points, gate=settings.gate, adaptation=settings.adaptation
    )
    slam = Slam(small.first, asked)
    for measured in small.measured:
        if measured.t_ns == small.first.t_ns:
            slam.take(measured)
    result = slam.run(small.inputs, small.measured)
    return _solution(task, small.inputs, result), innovations_of(result.judged)


def _solution(task: Task, inputs: Inputs, result: SlamResult) -> Solution:
    t_ns, track, K = task.t_ns, task.track, len(task.t_ns)
    start = task.initial
    at = np.concatenate([[start.t_ns], result.t_ns])
    first = np.concatenate([start.p_n, [rph_from_matrix(start.R_nb)[2]]])
    first_cov = np.diag([*start.sigma_p**2, (start.R_nb @ start.cov_rotation_b @ start.R_nb.T)[2, 2]])
    y, cov = np.vstack([first, result.y]), np.concatenate([first_cov[None], result.cov])
    k = np.searchsorted(at, t_ns, side="right") - 1
    rph, rph_k = rph_from_matrix(track.rotation_at(t_ns)), rph_from_matrix(track.rotation_at(at[k]))
    off = y[k, PSI] - rph_k[:, 2]
    turn = matrix_from_rph(np.column_stack([np.zeros((K, 2)), off]))
    R_nb = matrix_from_rph(np.column_stack([rph[:, :2], rph[:, 2] + off]))
    way = (turn @ (track.position_at(t_ns) - track.position_at(at[k]))[:, :, None])[..., 0]
    v_n = (turn @ track.velocity_at(t_ns)[:, :, None])[..., 0]
    # dead reckoning knows the velocity after a loss of the log already in it
    step = np.minimum(np.searchsorted(inputs.t_ns, t_ns), len(inputs) - 1)
    lost = inputs.age_s[step] > 0.0
    u = inputs.u[step][lost]
    v_n[lost] = np.column_stack([*turned((rph[:, 2] + off)[lost], u[:, 0], u[:, 1]), u[:, 2]])
    way[lost] = v_n[lost] * (t_ns - at[k])[lost, None] * 1e-9
    tilt = task.prepared.dive.rig.imu.accel_bias_sigma / STANDARD_GRAVITY
    cov_n = np.zeros((K, 6, 6))
    cov_n[:, 0, 0] = cov_n[:, 1, 1] = tilt**2
    cov_n[:, 2, 2] = cov[k, PSI, PSI]
    cov_n[:, 3:, 3:] = cov[k, : VEHICLE - 1, : VEHICLE - 1]
    cov_n[:, 2, 3:] = cov_n[:, 3:, 2] = cov[k, PSI, : VEHICLE - 1]
    to_body = np.zeros((K, 6, 6))
    to_body[:, :3, :3] = to_body[:, 3:, 3:] = np.swapaxes(R_nb, 1, 2)
    bias = np.broadcast_to(track.bias_gyro, (len(track.t_ns), 3))[np.searchsorted(track.t_ns, t_ns, side="right") - 1]
    return Solution(
        origin=task.prepared.origin,
        t_ns=t_ns,
        R_nb=R_nb,
        p_n=y[k, : VEHICLE - 1] + way,
        v_n=v_n,
        bias_gyro=bias + task.prepared.rest.bias_gyro,
        bias_accel=np.zeros((K, 3)),
        cov_pose=to_body @ cov_n @ np.swapaxes(to_body, 1, 2),
        cov_v=np.full((K, 3, 3), np.nan),
        cov_bias=np.full((K, 6, 6), np.nan),
    )
