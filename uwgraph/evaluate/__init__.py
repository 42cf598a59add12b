"""Judging a solution against a reference, and writing what people and programs read."""

from uwgraph.evaluate.align import Alignment
from uwgraph.evaluate.judge import Judged, judge
from uwgraph.evaluate.metrics import Comparison, Metrics, compare, metrics, nees, nees_bounds
from uwgraph.evaluate.output import write_solution
from uwgraph.evaluate.people import People, people
from uwgraph.evaluate.reference import ReferenceAt, reference_at
from uwgraph.evaluate.table import solution_table, trajectory_tum

__all__ = [
    "Alignment",
    "Comparison",
    "Judged",
    "Metrics",
    "People",
    "ReferenceAt",
    "compare",
    "judge",
    "metrics",
    "nees",
    "nees_bounds",
    "people",
    "reference_at",
    "solution_table",
    "trajectory_tum",
    "write_solution",
]
