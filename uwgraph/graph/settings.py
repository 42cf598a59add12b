"""What the user can choose about a smoothing run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from uwgraph.dive.rig import NonNegative, Positive, Settings

Quantile = Annotated[float, Field(gt=0.5, lt=1.0)]


class SmoothSettings(Settings):
    """Settings of :func:`uwgraph.graph.smooth`; every default suits a tactical to MEMS grade AUV."""

    keyframe_period_s: Positive = 1.0
    """Usual time between keyframes; moved to the DVL's pings, two can be up to twice as far apart."""
    keyframe_turn_deg: Positive = 30.0
    """A turn larger than this makes a keyframe of its own."""
    initial: Literal["auto", "reference"] = "auto"
    """Where the first state comes from: the dive's own sensors, or the first second of its reference."""
    heading_deg: float | None = None
    """The user's word on the heading at the start (true, clockwise from north)."""
    heading_sigma_deg: Positive = 2.0
    """How sure the user's word is."""
    position_sigma_m: Positive = 0.1
    """1-sigma of the first position where it is the origin of the dive or the reference's word."""
    attitude_sigma_deg: Positive = 0.03
    """1-sigma of the reference's first attitude."""
    dvl_calibration: bool = True
    """Estimate scale and misalignment of the DVL, with the rig's sigmas as the prior."""
    odometry: bool = True
    """Use the dive's visual odometry."""
    closures: bool = True
    """Use the dive's closures, as far as they agree with the odometry and with each other."""
    closure_gate: Quantile = 0.9999
    """Share of true closures that agree with what the dive says without closures."""
    closure_pairs: Quantile = 0.9999
    """Share of pairs of true closures that agree with each other."""
    max_closures: Annotated[int, Field(ge=1)] = 600
    """Of more closures, so many evenly spaced ones are judged: their joint covariance takes memory."""
    closure_inliers: Quantile = 0.999
    """Share of true closures that fit the final trajectory."""
    loss: Literal["huber", "cauchy", "none"] = "huber"
    """Robust loss on DVL, fixes, heading, sun and visual odometry."""
    loss_width: Positive = 2.0
    """Where the loss bends, in sigmas."""
    max_iterations: int = 30
    time_limit_s: Positive = 3600.0
    tolerance: NonNegative = 1e-6
    """Stop when the largest step, in 1/1000 rad and cm, is below this, or the cost falls by less, relatively."""
    covariances: bool = True
    """Whether to compute the 1-sigma of every state."""
