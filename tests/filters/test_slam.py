"""AUKF-SLAM in a simulated world, and its behaviour as a filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from slam_world import INPUT_NOISE, LAP_S, SECOND, World, inputs_between, patrol, world

from uwgraph.errors import DataError
from uwgraph.filters.kinematic import InputNoise, Inputs, Kinematic, depth, fix, heading
from uwgraph.filters.place_nodes import PlaceSettings, Sighting
from uwgraph.filters.settings import Adaptation
from uwgraph.filters.slam import Slam, SlamResult, SlamSettings
from uwgraph.frames import wrap_pi
from uwgraph.types import FloatArray

ADAPTIVE = SlamSettings(inputs=INPUT_NOISE)
FIXED = SlamSettings(inputs=INPUT_NOISE, learns="nothing")
SEEDS = range(20)


@dataclass(frozen=True, eq=False)
class Run:
    """A filter's run over a simulated patrol, against its truth."""

    world: World
    result: SlamResult

    @property
    def errors(self) -> FloatArray:
        """Shape (K, 4)."""
        e = self.result.y - self.world.truth
        e[:, 3] = wrap_pi(e[:, 3])
        return e

    def rmse(self, begin: int = 0) -> float:
        """Horizontal, m."""
        return float(np.sqrt(np.mean(np.sum(self.errors[begin:, :2] ** 2, axis=1))))

    @property
    def nees(self) -> float:
        """Of position and heading, over 4, mean over time."""
        e = self.errors[:, :, None]
        return float(np.mean(np.swapaxes(e, 1, 2) @ np.linalg.solve(self.result.cov, e))) / 4.0

    @property
    def made_by(self) -> dict[int, int]:
        """The true place behind each label, by the sighting that made it."""
        each = zip(self.result.sighted, self.world.seen, strict=True)
        return {s.label: place for s, place in each if s.verdict == "new" and s.label is not None}

    @property
    def false(self) -> int:
        """Sightings that were taken for another place."""
        each = zip(self.result.sighted, self.world.seen, strict=True)
        return sum(self.made_by[s.label] != place for s, place in each if s.label is not None)

    @property
    def duplicates(self) -> int:
        """Nodes too many in the end."""
        places = [self.made_by[node.label] for node in self.result.nodes]
        return len(places) - len(set(places))


def run(over: World, settings: SlamSettings = ADAPTIVE, nodes: bool = True, aided: bool = True) -> Run:
    measured = [*(over.direct if aided else []), *(over.sightings if nodes else [])]
    return Run(over, Slam(over.first, settings).run(over.inputs, measured))


@cache
def patrols() -> Sequence[Run]:
    return [run(world(seed)) for seed in SEEDS]


def rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.slow
def test_places_bound_the_error_and_the_covariance_says_so():
    with_nodes = patrols()
    without = [run(r.world, nodes=False) for r in with_nodes]
    reckoned = [run(r.world, FIXED, nodes=False, aided=False) for r in with_nodes[:10]]
    assert rms([r.rmse() for r in with_nodes]) < 0.5 * rms([r.rmse() for r in without])
    assert rms([r.rmse() for r in with_nodes]) < 0.35 * rms([r.rmse() for r in reckoned])
    for runs in (with_nodes, without):
        # a run's errors are of one piece: each counts as 4 draws, and 3 sigma of their mean are allowed
        assert np.mean([r.nees for r in runs]) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / (4 * len(SEEDS))))
    assert all(np.linalg.eigvalsh(r.result.cov).min() > 0.0 for r in with_nodes)


@pytest.mark.slow
def test_both_gates_make_no_false_association_where_one_does():
    both = patrols()
    assert sum(r.false for r in both) == 0
    assert sum(r.duplicates for r in both) == 0
    some = [r.world for r in both[:5]]
    by_look = [run(w, ADAPTIVE.model_copy(update={"places": PlaceSettings(gate=1.0)})) for w in some]
    assert sum(r.false for r in by_look) >= 10
    assert rms([r.rmse() for r in by_look]) > 3.0 * rms([r.rmse() for r in both[:5]])
    # places alone: what lies close to another place waits for the filter to be sure, and becomes two nodes
    by_place = [run(w, ADAPTIVE.model_copy(update={"places": PlaceSettings(descriptor_gate=np.inf)})) for w in some[:2]]
    assert sum(r.duplicates for r in by_place) > 0


@pytest.mark.slow
def test_noise_that_grows_is_learnt_and_the_estimate_better_for_it():
    change = 3 * LAP_S // 2
    worlds = [world(seed, 5 * LAP_S, step_at=change) for seed in range(3)]
    adaptive, fixed = ([run(w, s) for w in worlds] for s in (ADAPTIVE, FIXED))
    assert rms([r.rmse(change) for r in adaptive]) < 0.8 * rms([r.rmse(change) for r in fixed])
    assert np.mean([r.nees for r in adaptive]) < 0.8 * np.mean([r.nees for r in fixed])
    assert sum(r.false for r in adaptive) == 0
    believed = [[np.mean(row.noise) for row in r.result.judged if row.kind == "place"] for r in adaptive]
    np.testing.assert_allclose([np.mean(noise[: len(noise) // 3]) for noise in believed], 1.0, atol=0.2)
    # of 3, and from below: what is far beyond the gate is not looked at
    assert all(1.8 < noise[-1] < 3.5 for noise in believed)


def test_duplicates_are_fused():
    """Descriptors so noisy that a place is often not recognised, and gets a second node."""
    noisy = world(3, descriptor_sigma=0.12)
    separate = run(noisy, ADAPTIVE.model_copy(update={"places": PlaceSettings(radius_m=1e-9)})).duplicates
    fused = run(noisy)
    left, false = fused.duplicates, fused.false
    assert separate >= 10
    assert left <= separate // 2
    assert false == 0


def test_a_filter_that_was_carried_off_finds_back():
    """The log misses 16 m to the side: three places agree where the vehicle is, and the filter believes them."""
    for seed in (0, 1):
        made = world(seed, 5 * LAP_S // 2)
        u, off = made.inputs.u.copy(), LAP_S + 30
        u[off : off + 4, 1] += 4.0
        carried = run(replace(made, inputs=replace(made.inputs, u=u)))
        horizontal = np.linalg.norm(carried.errors[:, :2], axis=1)
        assert horizontal[off + 5] > 14.0
        assert np.all(horizontal[off + 120 :] < 3.0)


def test_a_place_that_looks_like_another_moves_nothing_however_long_it_is_in_view():
    slam = Slam(Kinematic(INPUT_NOISE).start(0, [0.0, 0.0, 0.0], 0.0, 1e-2 * np.eye(4)), ADAPTIVE)
    look, R, t = np.ones(8), 0.01 * np.eye(3), 0
    for k in range(6):
        slam.take(Sighting(0, np.array([k * 10.0, 5.0, 2.0]), R, np.eye(8)[k]))
    slam.take(Sighting(0, np.array([3.0, 1.0, 2.0]), R, look))
    before = slam.belief
    for _ in range(100):
        slam.take(Sighting(t, np.array([18.0, 1.0, 2.0]), R, look + 0.01))
    assert all(s.verdict == "doubtful" and s.label is None for s in slam.sighted[-100:])
    np.testing.assert_array_equal(slam.belief.x.y, before.x.y)
    np.testing.assert_array_equal(slam.belief.S, before.S)


def test_the_map_has_no_more_nodes_than_allowed_and_keeps_those_seen_again():
    few = ADAPTIVE.model_copy(update={"places": PlaceSettings(most=8)})
    slam = Slam((made := world(0)).first, few)
    result = slam.run(made.inputs, [*made.direct, *made.sightings])
    assert len(result.nodes) == 8
    assert slam.belief.x.size == 8 + 8 * 3
    assert all(node.cov.shape == (3, 3) and np.linalg.eigvalsh(node.cov).min() > 0.0 for node in result.nodes)
    assert Run(made, result).false == 0


def test_places_with_headings_correct_the_heading():
    noise = InputNoise(rate_density=5e-3)
    truth = patrol(LAP_S)
    inputs = Inputs(np.arange(1, LAP_S + 1) * SECOND, inputs_between(truth) + 8e-4 * np.eye(4)[3])
    start = Kinematic(noise).start(0, truth[0, :3], float(truth[0, 3]), 1e-4 * np.eye(4))
    slam, cov = Slam(start, SlamSettings(inputs=noise)), np.diag([0.1, 0.1, 0.1, 0.02]) ** 2
    sightings = []
    for t in (0, 5, LAP_S):  # home again, seen with a heading: the first pose itself
        c, s = np.cos(truth[t, 3]), np.sin(truth[t, 3])
        d = truth[0] - truth[t]
        z = np.array([c * d[0] + s * d[1], c * d[1] - s * d[0], d[2], d[3]])
        sightings.append(Sighting(t * SECOND, z, cov, np.ones(4)))
    slam.take(sightings[0])
    result = slam.run(inputs, sightings[1:])
    assert [s.verdict for s in result.sighted] == ["new", "known", "known"]
    assert abs(result.y[-2, 3] - truth[-2, 3]) > 0.1
    assert abs(result.y[-1, 3] - truth[-1, 3]) < 0.05
    assert result.nodes[0].pose.shape == (4,)


def system_run(settings: SlamSettings, seed: int, missing: float = 0.0) -> tuple[float, Slam]:
    """Error late in a run [m] whose inputs' noise is 0.1 m/s, with fixes and headings every second."""
    rng, truth = np.random.default_rng(seed), patrol(500)
    stamps = np.arange(1, 501) * SECOND
    white = rng.normal(0.0, [0.1, 0.1, 0.1, 1e-3], (500, 4))
    u = inputs_between(truth) + white - [missing, 0.0, 0.0, 0.0]
    measured = [
        m
        for t, pose in zip(stamps.tolist(), truth[1:], strict=True)
        for m in (
            fix(t, pose[:3] + rng.normal(0.0, 0.3, 3), 0.09 * np.eye(3)),
            heading(t, pose[3] + rng.normal(0.0, 0.02), 0.02),
        )
    ]
    slam = Slam(Kinematic(settings.inputs).start(0, truth[0, :3], float(truth[0, 3]), 1e-2 * np.eye(4)), settings)
    off = (slam.run(Inputs(stamps, u), measured).y - truth[1:])[250:, :2]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))), slam


def test_noise_of_the_system_is_learnt_alone_and_not_together_with_the_sensors():
    stated = SlamSettings(inputs=InputNoise(velocity_density=0.02, rate_density=1e-3), learns="nothing")
    error, slam = {}, {}
    for learns in ("nothing", "system", "both"):
        error[learns], slam[learns] = system_run(stated.model_copy(update={"learns": learns}), 0)
    believed = np.sqrt(np.diag(slam["system"].system.root @ slam["system"].system.root.T))[:3]
    assert np.all((believed > 0.04) & (believed < 0.15))
    assert error["system"] < 0.85 * error["nothing"]
    assert error["both"] > error["system"]


def test_mean_of_the_system_noise_is_what_the_inputs_lack():
    settings = SlamSettings(inputs=InputNoise(velocity_density=0.1), learns="system", system_mean=True)
    _, slam = system_run(settings, 0, missing=0.2)
    np.testing.assert_allclose(slam.system.mean[:3], [0.2, 0.0, 0.0], atol=0.06)


def test_the_documents_own_criterion_can_be_chosen():
    chosen = Adaptation(noise="unbiased", convergence="document")
    made = world(1, LAP_S)
    result = run(made, ADAPTIVE.model_copy(update={"adaptation": chosen})).result
    assert np.all(np.isfinite(result.y))
    assert any(row.fading > 1.0 for row in result.judged)


def test_measurements_between_inputs_are_taken_at_their_time():
    first = Kinematic(InputNoise()).start(0, [0.0, 0.0, 5.0], 0.0, 1e-4 * np.eye(4))
    inputs = Inputs(np.array([2 * SECOND, 4 * SECOND]), np.array([[1.0, 0.0, 0.0, 0.1], [1.0, 0.0, 0.0, -0.1]]))
    late, never = depth(3 * SECOND, 5.0, 0.1), depth(5 * SECOND, 9.0, 0.1)
    result = Slam(first).run(inputs, [never, late])
    assert [(row.kind, row.t_ns) for row in result.judged] == [("depth", 3 * SECOND)]
    np.testing.assert_allclose(
        result.y[-1], [4.0 * np.sinc(0.1 / np.pi) * np.cos(0.1), result.y[-1, 1], 5.0, 0.0], atol=0.02
    )


def test_the_filter_refuses_what_it_cannot_use():
    first = Kinematic(InputNoise()).start(SECOND, [0.0, 0.0, 0.0], 0.0, np.eye(4))
    slam = Slam(first)
    with pytest.raises(DataError, match="backwards"):
        slam.advance(0, np.zeros(4))
    with pytest.raises(DataError, match="the filter is at"):
        slam.take(depth(0, 1.0, 0.1))
    with pytest.raises(DataError, match="asks for 8"):
        Slam(first, SlamSettings(inputs=INPUT_NOISE))
