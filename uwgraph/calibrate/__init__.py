"""Calibration: the rig's numbers from dives, by smoothing with them as variables."""

from uwgraph.calibrate.engine import calibrate_dives
from uwgraph.calibrate.parameters import Limits, Priors
from uwgraph.calibrate.reference_aids import ReferenceUse
from uwgraph.calibrate.result import Calibration, Estimate

__all__ = ["Calibration", "Estimate", "Limits", "Priors", "ReferenceUse", "calibrate_dives"]
