"""The benchmark of the recorded sky compass at its limits."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("UWGRAPH_DATA", ROOT.parent / "shared" / "data")) / "sky_compass"


@pytest.mark.data
@pytest.mark.slow
def test_recorded_turns():
    pytest.importorskip("rosbags")
    if not DATA.is_dir():
        pytest.skip(f"no {DATA}: set UWGRAPH_DATA to the folder of the recordings")
    command = [sys.executable, ROOT / "benchmarks" / "sky_compass.py", DATA, "--json"]
    report = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    assert len(report["figures"]) == 3
    assert all(figure["met"] for figure in report["figures"]), report["figures"]
    faulty = [row["unit"] for row in report["units"] if row["found"] != "sound"]
    assert faulty == [5, 7]
