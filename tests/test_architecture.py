"""The direction of the arrows, and what a start costs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HEAVY = ("gtsam", "open3d", "cv2", "matplotlib", "scipy", "pandas", "pyarrow", "numpy")


def loaded_after(statement: str) -> set[str]:
    """Top-level names in ``sys.modules`` of a fresh interpreter."""
    code = f"import sys\n{statement}\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_import_contracts_hold() -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    run = subprocess.run([lint, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr


def test_factors_stand_alone() -> None:
    assert "uwgraph" not in loaded_after("import factors")


def test_the_command_line_starts_without_heavy_modules() -> None:
    assert not loaded_after("import uwgraph.cli") & set(HEAVY)


@pytest.mark.parametrize("room", ["dive", "simulate", "graph", "evaluate", "sun.estimate"])
def test_no_room_loads_what_only_maps_or_pictures_need(room: str) -> None:
    assert not loaded_after(f"import uwgraph.{room}") & {"open3d", "evo", "matplotlib"}


@pytest.mark.parametrize("room", ["dive", "graph", "evaluate"])
def test_only_images_need_opencv(room: str) -> None:
    assert "cv2" not in loaded_after(f"import uwgraph.{room}")
