"""What was done to a log, and what its user must know: gathered on the way, told in the report."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Notes:
    """Lists that grow."""

    conversions: list[str] = field(default_factory=list)
    caveats: list[str] = field(default_factory=list)
