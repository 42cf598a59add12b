"""What the user can choose about a smoothing run."""

from __future__ import annotations

from typing import Literal

from uwgraph.dive.rig import NonNegative, Positive, Settings


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
    loss: Literal["huber", "cauchy", "none"] = "huber"
    """Robust loss on DVL, fixes, heading and sun."""
    loss_width: Positive = 2.0
    """Where the loss bends, in sigmas."""
    max_iterations: int = 30
    time_limit_s: Positive = 3600.0
    tolerance: NonNegative = 1e-6
    """Stop when the largest step, in 1/1000 rad and cm, is below this, or the cost falls by less, relatively."""
    covariances: bool = True
    """Whether to compute the 1-sigma of every state."""
