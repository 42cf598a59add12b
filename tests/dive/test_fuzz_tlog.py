"""Mutated telemetry logs."""

from __future__ import annotations

import shutil
from pathlib import Path

from ardusub_logs import dive as messages
from ardusub_logs import telemetry
from fuzzing import survives

from uwgraph.dive.importing import import_dive
from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.reading import LogOptions
from uwgraph.types import Origin


def test_mutated_telemetry_logs(tmp_path: Path) -> None:
    dive = tmp_path / "dive"
    options = LogOptions(wishes=Wishes(origin=Origin(0.844, -2.175)))

    def call(folder: Path) -> None:
        shutil.rmtree(dive, ignore_errors=True)
        import_dive(folder / "log.tlog", dive, "tlog", options=options)

    tally = survives(call, {"log.tlog": telemetry(messages(5.0))}, tmp_path)
    print(tally)
    assert tally.imported > 0
    assert tally.refused > 0
