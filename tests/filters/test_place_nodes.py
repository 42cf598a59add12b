"""Places in the state: how they are put there, told apart, fused and dropped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import DataError
from uwgraph.filters.kinematic import InputNoise, Kinematic
from uwgraph.filters.place_nodes import Places, PlaceSettings, Sighting, associate, fused, relative
from uwgraph.filters.state import Belief
from uwgraph.filters.unscented import Spread
from uwgraph.filters.votes import AGREEING, Votes
from uwgraph.types import FloatArray

SPREAD, GATES = Spread(), PlaceSettings()
LOOKS = 1.2 * np.eye(6)
"""Descriptors of places that look different: d_M^2 = 2.9."""
SIGMA = 0.2
FEW = settings(max_examples=40, deadline=None)


def vehicle(psi: float = 0.3, sigma: float = 0.5, sigma_psi: float = 0.02) -> Belief:
    return Kinematic(InputNoise()).start(0, [1.0, 2.0, 3.0], psi, np.diag([sigma, sigma, 0.1, sigma_psi]) ** 2)


def sighting(z: list[float] | FloatArray, look: FloatArray, sigma: float = SIGMA, t_ns: int = 0) -> Sighting:
    z = np.asarray(z, dtype=np.float64)
    return Sighting(t_ns, z, sigma**2 * np.eye(len(z)), look)


def seen_at(places: Places, k: int, off: FloatArray | float = 0.0) -> FloatArray:
    """Where the vehicle expects the k-th node, and something more."""
    expected: FloatArray = relative(places.belief.x.y[None], places.at(k))[0]
    return expected + off


def verdict(places: Places, z: FloatArray, look: FloatArray, gates: PlaceSettings = GATES):
    return associate(places, sighting(z, look), np.eye(len(z)), gates, SPREAD)


@given(st.floats(-4.0, 4.0), st.sampled_from([3, 4]), st.integers(0, 1000))
@FEW
def test_a_new_node_stands_where_it_is_seen(psi: float, m: int, seed: int):
    z = np.random.default_rng(seed).normal(0.0, 5.0, m)
    before = vehicle(psi)
    places = Places(before).with_node(sighting(z, LOOKS[0]), 7)
    np.testing.assert_allclose(seen_at(places, 0), z, atol=1e-10)
    # to first order its covariance is what moving vehicle and sighting makes of theirs
    c, s = np.cos(psi), np.sin(psi)
    G_x, G_z = np.eye(m, 4), np.eye(m)
    G_z[:2, :2] = [[c, -s], [s, c]]
    G_x[:2, 3] = -(s * z[0] + c * z[1]), c * z[0] - s * z[1]
    expected = np.block(
        [[before.P, before.P @ G_x.T], [G_x @ before.P, G_x @ before.P @ G_x.T + SIGMA**2 * G_z @ G_z.T]]
    )
    np.testing.assert_allclose(places.belief.P, expected, atol=1e-10)
    assert [(node.label, node.count) for node in places.nodes] == [(7, 1)]


def map_of(zs: list[list[float]], looks: list[FloatArray], belief: Belief | None = None) -> Places:
    places = Places(belief or vehicle())
    for k, (z, look) in enumerate(zip(zs, looks, strict=True)):
        places = places.with_node(sighting(z, look, t_ns=k), k)
    return places


def test_both_gates_have_to_pass():
    places = map_of([[5.0, 0.0, 1.0], [5.0, 9.0, 1.0]], [LOOKS[0], LOOKS[1]])
    known = verdict(places, seen_at(places, 1, 0.1), LOOKS[1])
    assert (known.verdict, known.nodes) == ("known", (1,))
    assert verdict(places, seen_at(places, 1, 0.1), LOOKS[2]).verdict == "new"  # another look, close by
    assert verdict(places, seen_at(places, 0, 0.1), LOOKS[1]).verdict == "doubtful"  # known look, elsewhere
    assert verdict(places, seen_at(places, 0, 30.0), LOOKS[2]).verdict == "new"


def test_one_gate_alone_is_fooled_where_both_are_not():
    places = map_of([[5.0, 0.0, 1.0]], [LOOKS[0]])
    far, other = seen_at(places, 0, 20.0), LOOKS[3]
    assert verdict(places, far, LOOKS[0], PlaceSettings(gate=1.0)).verdict == "known"
    assert verdict(places, seen_at(places, 0), other, PlaceSettings(descriptor_gate=np.inf)).verdict == "known"


def test_of_several_that_pass_the_nearest_unless_another_is_as_likely():
    alike = [LOOKS[0], LOOKS[0] + 0.1]
    places = map_of([[5.0, 0.0, 1.0], [5.0, 0.8, 1.0]], alike)
    assert verdict(places, seen_at(places, 1), LOOKS[0]).nodes == (1, 0)
    between = 0.5 * (seen_at(places, 0) + seen_at(places, 1))
    assert verdict(places, between, LOOKS[0]).verdict == "ambiguous"
    assert verdict(places, between, LOOKS[0], PlaceSettings(odds=1.0)).verdict == "known"


def test_common_errors_do_not_close_the_gate():
    """A vehicle that is 30 m uncertain still tells places apart that it saw on the same way."""
    places = map_of([[5.0, 0.0, 1.0]], [LOOKS[0]], vehicle(sigma=30.0))
    assert verdict(places, seen_at(places, 0, [0.1, 0.0, 0.0]), LOOKS[0]).verdict == "known"
    assert verdict(places, seen_at(places, 0, [3.0, 0.0, 0.0]), LOOKS[0]).verdict == "doubtful"


def test_share_of_good_sightings_within_the_gate():
    rng, hits = np.random.default_rng(0), 0
    places = map_of([[5.0, -2.0, 1.0]], [LOOKS[0]])
    for _ in range(400):
        truth = places.belief.x.plus(places.belief.S @ rng.normal(size=7))
        z = relative(truth.y[None], places.at(0))[0] + rng.normal(0.0, SIGMA, 3)
        hits += verdict(places, z, LOOKS[0]).verdict == "known"
    assert 0.97 <= hits / 400 <= 1.0  # 0.99, with a deviation of 0.005


def test_places_with_a_heading_wrap():
    places = map_of([[5.0, 0.0, 1.0, 3.1]], [LOOKS[0]])
    z = seen_at(places, 0)
    turned, opposite = z + 2.0 * np.pi * np.eye(4)[3], z + np.pi * np.eye(4)[3]
    assert verdict(places, turned, LOOKS[0]).d2 == pytest.approx(verdict(places, z, LOOKS[0]).d2, abs=1e-9)
    assert verdict(places, opposite, LOOKS[0]).verdict == "doubtful"


def two_of_one_place(off: float, sigma: float = SIGMA) -> Places:
    """A place that got two nodes."""
    places = Places(vehicle()).with_node(sighting([5.0, 0.0, 1.0], LOOKS[0], sigma), 3)
    return places.with_node(sighting([5.0 + off, 0.0, 1.0], LOOKS[0] + 0.05, sigma, t_ns=9), 8)


def test_nodes_that_are_one_place_are_fused():
    places = two_of_one_place(0.3)
    one = fused(places, 1, 0, GATES, SPREAD)
    assert one is not None
    assert [(n.label, n.count, n.seen_ns) for n in one.nodes] == [(3, 2, 9)]
    np.testing.assert_allclose(one.nodes[0].descriptor, LOOKS[0] + 0.025)
    # as if it had been seen twice: in the middle, and as well known as by two sightings
    np.testing.assert_allclose(seen_at(one, 0), [5.15, 0.0, 1.0], atol=5e-3)
    off = Places(one.belief, one.nodes, 3)
    seen = off.seen(sighting(seen_at(off, 0), LOOKS[0]), 0, SPREAD).spread * SIGMA**2
    np.testing.assert_allclose(np.diag(seen), SIGMA**2 / 2.0, rtol=0.02)


@pytest.mark.parametrize(
    ("places", "gates"),
    [
        (two_of_one_place(2.0), GATES),  # further apart than their covariance allows
        (two_of_one_place(0.1, sigma=2.0), GATES),  # not known well enough
        (two_of_one_place(0.3), PlaceSettings(descriptor_gate=0.01)),  # not alike
    ],
)
def test_nodes_that_are_perhaps_two_places_stay(places: Places, gates: PlaceSettings):
    assert fused(places, 0, 1, gates, SPREAD) is None


def test_dropping_a_node_leaves_the_others_where_they_were():
    places = map_of([[5.0, 0.0, 1.0], [0.0, 5.0, 1.0], [-5.0, 0.0, 1.0]], list(LOOKS[:3]))
    after = places.dropped(1)
    assert [node.label for node in after.nodes] == [0, 2]
    np.testing.assert_allclose(seen_at(after, 1), [-5.0, 0.0, 1.0], atol=1e-12)
    keep = np.r_[0:7, 10:13]
    np.testing.assert_allclose(after.belief.P, places.belief.P[np.ix_(keep, keep)], atol=1e-12)


def test_the_least_useful_node_was_seen_least_and_longest_ago():
    places = map_of([[5.0, 0.0, 1.0], [0.0, 5.0, 1.0], [-5.0, 0.0, 1.0]], list(LOOKS[:3]))
    assert places.least_useful() == 0
    again = replace(sighting([0.0, 0.0, 0.0], LOOKS[0]), t_ns=50)
    places = places.renewed(0, places.nodes[0].seen_again(again))
    assert places.least_useful() == 1


def test_widening_is_about_the_vehicle_alone():
    places = map_of([[5.0, 0.0, 1.0]], [LOOKS[0]])
    wide = places.widened(np.array([3.0, -4.0, 0.0]))
    grown = wide.belief.P - places.belief.P
    np.testing.assert_allclose(np.diag(grown), [9.0, 16.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(grown, np.diag(np.diag(grown)), atol=1e-9)


def voted(*each: tuple[int, str]) -> Votes:
    """Votes after sightings by label: ``.`` for each that fitted, ``x`` for each that did not."""
    votes = Votes()
    for label, outcomes in each:
        for outcome in outcomes:
            votes = votes.after(label, outcome == ".", np.array([label / 10.0, 9.0, 0.0]))
    return votes


def test_a_place_in_view_for_long_has_one_vote():
    assert not voted((1, "..."), (2, ".."), (3, "."), (4, "x" * 50)).doubted
    assert voted((1, "..."), (2, "xx"), (3, "xxx"), (4, "xx"), (5, "xx")).doubted


def test_one_bad_sighting_is_no_vote_against_and_a_lone_place_never_decides():
    assert not voted(*[(k, "...x") for k in range(8)]).doubted
    assert not voted((1, "xxxx")).doubted
    assert not voted((1, "xxxx"), (2, "xxxx")).doubted


def test_votes_of_long_ago_are_forgotten():
    against = [(k, "xx") for k in range(8)]
    assert voted(*against).doubted
    assert not voted(*against, *[(k, "..") for k in range(20, 28)]).doubted


def test_agreement_is_about_the_same_place_of_the_vehicle():
    votes = voted(*[(k, "xx") for k in range(AGREEING)])
    assert votes.agree(np.array([0.0, 9.0, 0.0]), 1.0)
    assert not votes.agree(np.array([0.0, -9.0, 0.0]), 1.0)
    assert not voted(*[(k, "xx") for k in range(AGREEING - 1)]).agree(np.array([0.0, 9.0, 0.0]), 1.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: sighting([1.0, 2.0], LOOKS[0]),
        lambda: sighting([1.0, np.nan, 0.0], LOOKS[0]),
        lambda: sighting([1.0, 2.0, 0.0], np.full(6, np.nan)),
        lambda: sighting([1.0, 2.0, 0.0], LOOKS),
        lambda: sighting([1.0, 2.0, 0.0], LOOKS[0], sigma=0.0),
        lambda: map_of([[5.0, 0.0, 1.0]], [LOOKS[0]]).check(sighting([5.0, 0.0, 1.0, 0.0], LOOKS[0])),
        lambda: map_of([[5.0, 0.0, 1.0]], [LOOKS[0]]).check(sighting([5.0, 0.0, 1.0], LOOKS[0][:4])),
    ],
)
def test_bad_sightings_are_refused(make):
    with pytest.raises(DataError, match="sighting at 0") as error:
        make()
    assert error.value.remedy
