"""A real log, from the recording to the figures: import, check, smooth.

    python examples/02_real_log.py [RECORDING]

RECORDING is a folder that ``uwgraph import`` knows. Without it: run 1 of the Snapir AUV (Cohen & Klein 2025), if
``$UWGRAPH_DATA`` or ``../shared/data`` holds it as ``snapir/Trajectory1``.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from uwgraph.dive.check import check_dive
from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.errors import UwgraphError
from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[2] / "shared" / "data"))
SNAPIR = DATA / "snapir" / "Trajectory1"


def main(recording: Path, work: Path) -> None:
    report = import_dive(recording, work / "dive")
    print(f"read as {report.format}: {report.reason}")
    print(*(f"  {line}" for line in report.conversions + report.caveats), sep="\n")

    dive = read_dive(work / "dive")
    for finding in check_dive(dive).findings:
        if finding.level in ("error", "warning"):
            print(f"  {finding.level}: {finding.stream}: {finding.message}")

    solution = smooth(dive, SmoothSettings(initial="reference" if dive.reference else "auto"))
    for name, value in judge(dive, solution).metrics.items():
        if isinstance(value, float | int):
            print(f"{name:24}{value:12.3f}")


if __name__ == "__main__":
    source = Path(sys.argv[1]) if len(sys.argv) > 1 else SNAPIR
    if len(sys.argv) < 2 and not source.exists():
        print(f"{source} is not there. Name a recording, or get the Snapir runs from github.com/ansfl/A-KIT")
        sys.exit(0)
    try:
        with tempfile.TemporaryDirectory() as folder:
            main(source, Path(folder))
    except UwgraphError as error:
        sys.exit(f"error: {error}")
