"""What is broken in a log that is read as far as it goes."""

from __future__ import annotations

from collections.abc import Sequence

from uwgraph.errors import DataError


class Damage:
    """Collects what is broken, each place once, however often a log is read.

    Parameters
    ----------
    unit : str
        What places are counted in: ``byte`` or ``message``.
    """

    def __init__(self, unit: str = "byte") -> None:
        self.unit = unit
        self._skipped: dict[int, str] = {}
        self._end: tuple[int, str] | None = None

    def skip(self, at: int, what: str) -> None:
        """A block that is left out; what follows is read."""
        self._skipped.setdefault(at, what)

    def end(self, at: int, what: str) -> None:
        """Where reading ends."""
        if self._end is None or at > self._end[0]:
            self._end = (at, what)

    @property
    def caveats(self) -> tuple[str, ...]:
        """In words."""
        found = []
        if self._skipped:
            at, what = min(self._skipped.items())
            found.append(f"{len(self._skipped)} damaged blocks are left out, the first at {self.unit} {at}: {what}")
        if self._end is not None:
            at, what = self._end
            found.append(f"damaged at {self.unit} {at} ({what}): read up to there")
        return tuple(found)


def nothing_left(caveats: Sequence[str], where: str) -> DataError:
    """The error for a log in which nothing was found."""
    problem = caveats[-1] if caveats else "holds no topics"
    return DataError(problem, where=where, remedy="copy the log again from the vehicle")
