"""From a dive to a smoothed trajectory: keyframes, builder, solver, covariances, diagnosis."""

from uwgraph.graph.observed import Observed
from uwgraph.graph.settings import SmoothSettings
from uwgraph.graph.smooth import resample, smooth

__all__ = ["Observed", "SmoothSettings", "resample", "smooth"]
