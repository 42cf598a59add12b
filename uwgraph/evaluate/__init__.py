"""Judging a solution against a reference, and writing what people and programs read."""

from uwgraph.evaluate.align import Alignment
from uwgraph.evaluate.judge import Judged, judge
from uwgraph.evaluate.matching import Matching, compare_trajectories
from uwgraph.evaluate.metrics import Comparison, Metrics, compare, metrics, nees, nees_bounds
from uwgraph.evaluate.output import write_solution
from uwgraph.evaluate.people import People, people
from uwgraph.evaluate.reference import ReferenceAt, reference_at
from uwgraph.evaluate.table import solution_table, trajectory_tum
from uwgraph.evaluate.trajectory import Trajectory, trajectory_of, trajectory_of_solution
from uwgraph.evaluate.trajectory_file import read_trajectory
from uwgraph.evaluate.verdict import Verdict, judge_trajectory

__all__ = [
    "Alignment",
    "Comparison",
    "Judged",
    "Matching",
    "Metrics",
    "People",
    "ReferenceAt",
    "Trajectory",
    "Verdict",
    "compare",
    "compare_trajectories",
    "judge",
    "judge_trajectory",
    "metrics",
    "nees",
    "nees_bounds",
    "people",
    "read_trajectory",
    "reference_at",
    "solution_table",
    "trajectory_of",
    "trajectory_of_solution",
    "trajectory_tum",
    "write_solution",
]
