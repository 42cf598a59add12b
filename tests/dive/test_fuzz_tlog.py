"""Mutated telemetry logs."""

from __future__ import annotations

from pathlib import Path

from ardusub_logs import dive, telemetry
from fuzzing import survives

from uwgraph.dive.importing import read_recording
from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.reading import LogOptions
from uwgraph.types import Origin


def test_mutated_telemetry_logs(tmp_path: Path) -> None:
    options = LogOptions(wishes=Wishes(origin=Origin(0.844, -2.175)))
    files = {"log.tlog": telemetry(dive(3.0))}
    tally = survives(lambda folder: read_recording(folder / "log.tlog", "tlog", options=options), files, tmp_path)
    print(tally)
    assert tally.imported > 0
    assert tally.refused > 0
