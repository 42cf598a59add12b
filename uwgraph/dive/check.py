"""``check``: what is wrong or odd about a dive, and what to do about it, before anything is computed from it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from uwgraph.dive.checks.aiding import check_depth, check_dvl, check_headings, check_sun
from uwgraph.dive.checks.clocks import check_clocks
from uwgraph.dive.checks.finding import Finding, Level, Subject
from uwgraph.dive.checks.inertial import check_imu
from uwgraph.dive.checks.presence import check_presence
from uwgraph.dive.checks.stamps import check_stamps
from uwgraph.dive.inertial_track import inertial_track
from uwgraph.dive.model import Dive
from uwgraph.errors import EXIT_DATA

Check = Callable[[Subject], Iterator[Finding]]
CHECKS: tuple[Check, ...] = (
    check_imu,
    check_dvl,
    check_depth,
    check_headings,
    check_sun,
    check_clocks,
)
LEVELS: tuple[Level, ...] = ("error", "warning", "info", "ok")


@dataclass(frozen=True)
class CheckReport:
    """Everything that was looked at, the worst first."""

    findings: tuple[Finding, ...]

    def at(self, level: Level) -> tuple[Finding, ...]:
        """The findings of one level."""
        return tuple(f for f in self.findings if f.level == level)

    @property
    def exit_status(self) -> int:
        """That of ``uwgraph check``: 3 when there is an error, 0 otherwise."""
        return EXIT_DATA if self.at("error") else 0

    @property
    def summary(self) -> str:
        """Counts in words, as in ``0 errors, 2 warnings``."""
        counts = Counter(f.level for f in self.findings)
        return f"{counts['error']} errors, {counts['warning']} warnings"

    def rows(self) -> list[tuple[str, str, str, str, str]]:
        """Level, stream, check, message, remedy, for a table."""
        return [(f.level, f.stream, f.check, f.message, f.remedy) for f in self.findings]

    def to_json(self) -> str:
        """The findings as JSON: ``{"exit_status": 0, "findings": [{"level": ..., ...}]}``; null for no figure."""
        findings = [
            {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in asdict(f).items()}
            for f in self.findings
        ]
        return json.dumps({"exit_status": self.exit_status, "findings": findings}, indent=2)


def check_dive(dive: Dive, checks: tuple[Check, ...] = CHECKS) -> CheckReport:
    """Run the checks: presence and stamps always, then those given (all; :func:`check_clocks` takes the longest).

    A dive that breaks a rule is not refused here but reported. A stream whose stamps are out of order is left out of
    the other checks, and without a usable IMU so are those that need its motion.
    """
    findings = [*check_presence(dive), *check_stamps(dive)]
    broken = {f.stream: None for f in findings if f.check == "order"}
    dive = replace(dive, **broken)  # type: ignore[arg-type]
    usable = dive.imu is not None and len(dive.imu) > 1 and np.isfinite([dive.imu.f_s, dive.imu.w_s]).all()
    subject = Subject(dive, inertial_track(dive.imu, dive.rig.imu) if dive.imu is not None and usable else None)
    findings += [finding for check in checks for finding in check(subject)]
    return CheckReport(tuple(sorted(findings, key=lambda f: LEVELS.index(f.level))))
