"""Filters beside the graph, on the same measurement models: unscented, adaptive, extended, with a smoothing pass."""

from uwgraph.filters.estimate import Task, filter_dive, task_of
from uwgraph.filters.estimators import ESTIMATORS, Estimate, Estimator, EstimatorSettings, Named
from uwgraph.filters.settings import Adaptation, FilterSettings, SigmaPoints

__all__ = [
    "ESTIMATORS",
    "Adaptation",
    "Estimate",
    "Estimator",
    "EstimatorSettings",
    "FilterSettings",
    "Named",
    "SigmaPoints",
    "Task",
    "filter_dive",
    "task_of",
]
