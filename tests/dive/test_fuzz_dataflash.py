"""Mutated DataFlash logs."""

from __future__ import annotations

from pathlib import Path

from ardusub_logs import onboard
from fuzzing import survives

from uwgraph.dive.importing import read_recording


def test_mutated_dataflash_logs(tmp_path: Path) -> None:
    tally = survives(
        lambda folder: read_recording(folder / "log.BIN", "dataflash"), {"log.BIN": onboard(3.0)}, tmp_path
    )
    print(tally)
    assert tally.imported > 0
    assert tally.refused > 0
