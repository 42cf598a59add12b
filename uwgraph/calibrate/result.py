"""The outcome of a calibration: each number before and after, what is not told, and the rig to write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from uwgraph.calibrate.combine import Scatter, Unknowns, added, combine, scatter
from uwgraph.calibrate.information import Information
from uwgraph.calibrate.observability import Unseen, unseen
from uwgraph.calibrate.parameters import Parameter, with_values
from uwgraph.dive.clock_fit import ClockOffset
from uwgraph.dive.rig import Rig
from uwgraph.types import FloatArray


@dataclass(frozen=True)
class Estimate:
    """One number of the rig, in the rig file's units."""

    name: str
    """As in ``dvl.rotation_deg.yaw``; of a dive's own clock with the dive before it."""
    unit: str
    before: float
    """The rig's."""
    after: float
    """``before`` where refused."""
    sigma: float
    """1-sigma of the estimate, also of a refused one; wider where dives scatter more than their covariances say."""
    prior_sigma: float
    data_sigma: float
    """1-sigma from the dives alone, the number's own prior taken off; infinite where they say nothing."""
    observable: bool
    """False: not told by these dives, and left as it was."""
    dives: int
    """How many dives tell it."""
    scatter: float
    """Standard deviation between the dives, each on its own; NaN of less than two."""
    inflated: float = 1.0
    """Birge ratio by which ``sigma`` was multiplied; 1 where the dives agree."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What :func:`uwgraph.calibrate.calibrate_dives` found."""

    what: str
    estimates: tuple[Estimate, ...]
    """One a number that was freed; clocks of several dives as their mean."""
    clocks: tuple[Estimate, ...]
    """Clocks of each of several dives."""
    names: tuple[str, ...]
    covariance: FloatArray
    """Of the numbers ``names``, in their units, inflation included."""
    rig: Rig
    """The first dive's with what was found; of clocks of several dives the mean."""
    rigs: Mapping[str, Rig]
    """Each dive's own with what was found, its own clocks among it."""
    correlations: Mapping[str, Mapping[str, ClockOffset]]
    """Clock offsets by correlation alone, by dive and sensor."""
    unseen: tuple[Unseen, ...]
    """What these motions do not show, in words."""
    converged: bool
    iterations: int

    def estimate(self, name: str) -> Estimate:
        """The estimate of that name."""
        return next(e for e in (*self.estimates, *self.clocks) if e.name == name)


@dataclass(frozen=True, eq=False)
class Ending:
    """Where the iteration ended."""

    unknowns: Unknowns
    information: Sequence[Information]
    now: FloatArray
    """Where the information was linearised."""
    start: FloatArray
    """Start values of the unknowns, in their units: the priors' means."""
    own: FloatArray
    """The rig's values of the unknowns."""
    freed: Sequence[Parameter]
    labels: Sequence[str]
    converged: bool
    iterations: int


def reported(
    end: Ending, what: str, base: Rig, rigs: Sequence[Rig], correlations: Sequence[Mapping[str, ClockOffset]]
) -> Calibration:
    """The calibration from where the iteration ended."""
    u = end.unknowns
    data = added(u, end.information)
    found = combine(u, data, end.now)
    common = {i: _scatter(end, i) for i, p in enumerate(end.freed) if u.dive[u.places[0][i]] is None}
    inflation = np.ones(len(u))
    for i, s in common.items():
        inflation[u.places[0][i]] = s.birge
    scale = inflation * u.priors
    covariance = found.covariance * np.outer(scale, scale)
    values = np.where(found.told, _rounded(end.start + found.z * u.priors, np.sqrt(np.diag(covariance))), end.own)
    names = [p.name if d is None else f"{end.labels[d]}: {p.name}" for p, d in zip(u.parameters, u.dive, strict=True)]

    def of(which: int, dives: int, spread: float) -> Estimate:
        p, share = u.parameters[which], float(found.covariance[which, which])
        return Estimate(
            name=names[which],
            unit=p.unit,
            before=float(end.own[which]),
            after=float(values[which]),
            sigma=float(np.sqrt(covariance[which, which])),
            prior_sigma=p.prior,
            data_sigma=p.prior / float(np.sqrt(1.0 / share - 1.0)) if share < 1.0 else np.inf,
            observable=bool(found.told[which]),
            dives=dives,
            scatter=spread,
            inflated=float(inflation[which]),
        )

    estimates, clocks = [], []
    for i, p in enumerate(end.freed):
        if i in common:
            which = int(u.places[0][i])
            estimates.append(of(which, len(common[i].values), common[i].spread * p.prior))
            continue
        own = [of(int(place[i]), int(found.told[place[i]]), np.nan) for place in u.places]
        clocks += own
        estimates.append(_mean(p, own))
    several = len(u.places) > 1
    freed = np.flatnonzero(np.isfinite(u.limits))
    new = {e.name: e for e in estimates}
    return Calibration(
        what=what,
        estimates=tuple(estimates),
        clocks=tuple(clocks) if several else (),
        names=tuple(names[w] for w in freed),
        covariance=covariance[np.ix_(freed, freed)],
        rig=_stated(with_values(base, end.freed, [new[p.name].after for p in end.freed]), new),
        rigs={
            label: _stated(with_values(rig, end.freed, values[place[: len(end.freed)]].tolist()), new)
            for label, rig, place in zip(end.labels, rigs, u.places, strict=True)
        },
        correlations=dict(zip(end.labels, correlations, strict=True)),
        unseen=unseen(u, names, data, found),
        converged=end.converged,
        iterations=end.iterations,
    )


def _rounded(values: FloatArray, sigmas: FloatArray) -> FloatArray:
    """Values with three digits of their sigma."""
    unit = 10.0 ** (np.floor(np.log10(sigmas)) - 2)
    digits = np.maximum(-np.log10(unit), 0.0).round().astype(int)
    return np.array([round(float(v), int(d)) for v, d in zip(values, digits, strict=True)])


def _scatter(end: Ending, i: int) -> Scatter:
    return scatter(end.unknowns, end.information, end.now, i)


def _mean(p: Parameter, own: Sequence[Estimate]) -> Estimate:
    """The clocks of the dives as one: their mean, and its sigma from whichever is larger, theirs or the scatter."""
    told = [e for e in own if e.observable]
    chosen = told or own
    n = len(chosen)
    formal = float(np.sqrt(sum(e.sigma**2 for e in chosen))) / n
    spread = float(np.std([e.after for e in told], ddof=1)) if len(told) > 1 else np.nan
    return Estimate(
        name=p.name,
        unit=p.unit,
        before=float(np.mean([e.before for e in chosen])),
        after=round(float(np.mean([e.after for e in chosen])), 9),
        sigma=max(formal, spread / np.sqrt(n)) if len(told) > 1 else formal,
        prior_sigma=p.prior,
        data_sigma=float(np.mean([e.data_sigma for e in chosen])) / np.sqrt(n),
        observable=bool(told),
        dives=len(told),
        scatter=spread,
    )


def _stated(rig: Rig, new: Mapping[str, Estimate]) -> Rig:
    """The rig with what is left of the DVL's errors: sigma and scatter of the dives where they were told."""

    def left(e: Estimate, stated: float) -> float:
        return float(np.hypot(e.sigma, np.nan_to_num(e.scatter))) if e.observable else max(stated, 0.0)

    update: dict[str, float] = {}
    if "dvl.scale" in new:
        update["scale_sigma"] = left(new["dvl.scale"], rig.dvl.scale_sigma)
    turned = [e for name, e in new.items() if name.startswith("dvl.rotation_deg")]
    if turned:
        update["misalignment_sigma_deg"] = max(left(e, rig.dvl.misalignment_sigma_deg) for e in turned)
    return rig.model_copy(update={"dvl": rig.dvl.model_copy(update=update)}) if update else rig
