"""Calibration is smoothing with numbers of the rig as variables.

Each dive is smoothed with the rig as it stands; the graph then tells how the rig's numbers should change, with all
states eliminated; the dives' information is added, the rig changed, and so on until nothing moves. Which numbers are
freed (``what``) is the only difference between calibrating a DVL, the clocks and the mounting.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from uwgraph.calibrate.combine import Unknowns, added, combine
from uwgraph.calibrate.information import Information, rig_information
from uwgraph.calibrate.parameters import RATE, Limits, Parameter, Priors, What, chosen, leftovers, with_values
from uwgraph.calibrate.reference_aids import ReferenceUse, with_reference_aids
from uwgraph.calibrate.result import Calibration, Ending, reported
from uwgraph.calibrate.start import quiet_clocks, started
from uwgraph.dive import Dive
from uwgraph.dive.rig import Rig
from uwgraph.dive.rigfile import apply_rig
from uwgraph.errors import DataError, UwgraphError
from uwgraph.graph import SmoothSettings
from uwgraph.graph.smooth import solve_dive
from uwgraph.types import FloatArray, Solution

MAX_ITERATIONS = 12
STILL = 0.02
"""The rig stands still when nothing that is told would move by more than this part of its sigma."""

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it is done, 0 to 1."""


def calibrate_dives(
    dives: Sequence[Dive],
    what: What | Iterable[str],
    *,
    names: Sequence[str] = (),
    reference: ReferenceUse | None = None,
    common_clock: bool = False,
    rig: Rig | None = None,
    priors: Priors | None = None,
    limits: Limits | None = None,
    settings: SmoothSettings | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Estimate numbers of the rig from dives of one vehicle.

    Parameters
    ----------
    dives
        Common numbers start from the rig of the first; clock offsets from each dive's motion, or from its rig where
        the motion is too quiet for that.
    what
        ``dvl``, ``clock`` or ``mounting``, or names such as ``dvl.scale`` and ``depth.time_offset_s``.
    names
        Of the dives, for the report.
    reference
        Take the positions of the dives' references as fixes, in place of their own. The first state is then the
        reference's too, where it knows its attitude and ``settings`` are not given.
    common_clock
        One clock offset for all dives, not one each.
    rig
        Put onto all dives before anything else; their own clock offsets stay.
    settings
        Of the smoothing. ``dvl_calibration`` counts for nothing: what is not freed of the DVL's scale and mounting is
        estimated along, with the rig's sigmas.

    Raises
    ------
    DataError, InitialisationError, SolveError
        When a dive cannot be smoothed; the message names it.
    ConfigError
        When there is nothing to free.
    """
    if not dives:
        raise DataError("there is no dive to calibrate from", where="calibrate", remedy="name at least one")
    labels = tuple(names) or tuple(f"dive {i + 1}" for i in range(len(dives)))
    if rig is not None:
        dives = [apply_rig(dive, rig, keep_clocks=True) for dive in dives]
    base = dives[0].rig
    replaced = reference.replaces if reference else ()
    priors = priors or Priors()
    freed = chosen(what, dives, replaced, priors, limits or Limits())
    parameters = freed + leftovers(dives, base, freed, priors)
    begun = [started(dive, base, parameters) for dive in dives]
    unknowns = Unknowns.of(parameters, len(dives), common_clock=common_clock or len(dives) == 1)
    vehicle = [
        _Dive(label, dive, parameters, quiet_clocks(parameters, found), reference, _settings(dive, settings, reference))
        for label, (dive, found) in zip(labels, begun, strict=True)
    ]
    start = unknowns.values([dive.rig for dive, _ in begun])
    clocks = np.array([p.of_a_clock for p in unknowns.parameters])
    own = np.where(clocks, unknowns.values([dive.rig for dive in dives]), start)
    information, z, converged, rounds = _iterated(vehicle, unknowns, start, progress)
    return reported(
        Ending(unknowns, information, z, start, own, freed, labels, converged, rounds),
        what=what if isinstance(what, str) else "chosen",
        base=base,
        rigs=[dive.rig for dive, _ in begun],
        correlations=[found for _, found in begun],
    )


def _iterated(
    dives: Sequence[_Dive], unknowns: Unknowns, start: FloatArray, progress: Progress | None
) -> tuple[list[Information], FloatArray, bool, int]:
    """What the dives say with the rig where it stands still, where that is, whether it does, and the rounds taken."""
    applied = np.array([p.field != RATE for p in unknowns.parameters])
    z = np.zeros(len(unknowns))
    for number in range(1, MAX_ITERATIONS + 1):
        now = np.where(applied, z, 0.0)
        values = start + now * unknowns.priors
        information = []
        for d, (dive, place) in enumerate(zip(dives, unknowns.places, strict=True)):
            if progress:
                progress(f"round {number}: {dive.name}", (number - 1 + d / len(dives)) / MAX_ITERATIONS)
            information.append(dive.information(values[place]))
        found = combine(unknowns, added(unknowns, information), now)
        if number > 1 and (np.abs(found.z - z) <= STILL * found.sigma)[found.told].all():
            return information, now, True, number
        # what is not told stays: noise would drive it far from where the graph is linear
        z = np.where(found.told, found.z, 0.0)
    return information, now, False, MAX_ITERATIONS


@dataclass
class _Dive:
    """One dive, and where its last smoothing ended: the next begins there."""

    name: str
    dive: Dive
    parameters: tuple[Parameter, ...]
    quiet: Sequence[int]
    """Clocks that correlation does not find."""
    reference: ReferenceUse | None
    settings: SmoothSettings
    guess: Solution | None = field(default=None)

    def information(self, values: FloatArray) -> Information:
        """What the dive says with the rig at these values."""
        dive = replace(self.dive, rig=with_values(self.dive.rig, self.parameters, values))
        try:
            if self.reference:
                dive = with_reference_aids(dive, self.reference)
            smoothed = solve_dive(dive, self.settings, lambda doing, share: None, self.guess)
        except UwgraphError as error:
            raise type(error)(error.problem, where=f"{self.name}: {error.where}", remedy=error.remedy) from error
        self.guess = smoothed.solution
        replaced = self.reference.replaces if self.reference else ()
        return rig_information(smoothed, self.parameters, replaced, self.quiet)


def _settings(dive: Dive, settings: SmoothSettings | None, reference: ReferenceUse | None) -> SmoothSettings:
    if settings is None:
        settings = SmoothSettings()
        known = dive.reference is not None and np.isfinite(dive.reference.rph[:1]).all()
        if reference and known:
            settings = SmoothSettings(initial="reference", position_sigma_m=reference.sigma_m)
    return settings.model_copy(update={"dvl_calibration": False, "covariances": False})
