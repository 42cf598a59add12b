"""Mutated DataFlash logs."""

from __future__ import annotations

import shutil
from pathlib import Path

from ardusub_logs import onboard
from fuzzing import survives

from uwgraph.dive.importing import import_dive


def test_mutated_dataflash_logs(tmp_path: Path) -> None:
    dive = tmp_path / "dive"

    def call(folder: Path) -> None:
        shutil.rmtree(dive, ignore_errors=True)
        import_dive(folder / "log.BIN", dive, "dataflash")

    tally = survives(call, {"log.BIN": onboard(5.0)}, tmp_path)
    print(tally)
    assert tally.imported > 0
    assert tally.refused > 0
