"""From a dive to a smoothed trajectory: keyframes, builder, solver, covariances, diagnosis."""

from uwgraph.graph.settings import SmoothSettings
from uwgraph.graph.smooth import resample, smooth

__all__ = ["SmoothSettings", "resample", "smooth"]
