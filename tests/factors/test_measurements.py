"""Every measurement: Jacobians against differences, and the native factor against the Python one."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

import factors
from factors.noise import sqrt_information, sqrt_information_of_covariance

DEG = np.pi / 180.0
STATES = 50
KEYS = (gtsam.symbol("x", 3), gtsam.symbol("x", 4))
BODY_DIRECTION = np.array([0.48, -0.6, 0.64])
TILTED = gtsam.Rot3.RzRyRx(0.002, -0.001, 0.003).matrix()


def random_rotation(rng: np.random.Generator, near_pi: bool = False) -> gtsam.Rot3:
    """Any axis; any angle up to 3 rad, or one within 1e-2 of pi.

    Not within 2e-3: at 1e-3 GTSAM's logarithm of a pose changes over to a series, with a step of some 1e-7.
    """
    axis = rng.normal(size=3)
    angle = np.pi - rng.uniform(2e-3, 1e-2) if near_pi else rng.uniform(0.0, 3.0)
    return gtsam.Rot3.Expmap(axis / np.linalg.norm(axis) * angle)


def random_pose(rng: np.random.Generator, near_pi: bool = False) -> gtsam.Pose3:
    return gtsam.Pose3(random_rotation(rng, near_pi), rng.uniform(-100.0, 100.0, size=3))


def covariance(rng: np.random.Generator, n: int) -> np.ndarray:
    root = rng.normal(size=(n, n)) * rng.uniform(0.1, 2.0, size=n)
    return root @ root.T + 0.01 * np.eye(n)


def rank_two(rng: np.random.Generator) -> np.ndarray:
    s = rng.normal(size=3)
    s /= np.linalg.norm(s)
    P = np.eye(3) - np.outer(s, s)
    return P @ covariance(rng, 3) @ P


def dvl(turn: float) -> factors.DvlDisplacement:
    dR = gtsam.Rot3.Expmap(turn * np.array([0.36, 0.48, 0.8])).matrix()
    return factors.DvlDisplacement(np.array([1.5, -0.3, 0.2]), dR, np.diag([1e-4, 4e-2, 1e-2]))


def measurements() -> dict[str, factors.Measurement]:
    rng = np.random.default_rng(7)
    unmeasured_down = covariance(rng, 3)
    unmeasured_down[2], unmeasured_down[:, 2] = 0.0, 0.0
    unmeasured_down[2, 2] = np.inf
    arm = np.array([1.0, -0.4, 0.7])
    up_north = np.array([0.6, 0.64, -0.48])
    return {
        "depth": factors.Depth(12.3, 0.05, TILTED[:, 2], np.array([5.0, -3.0, 11.0]), 11.01, arm),
        "position": factors.PositionFix(np.array([4.0, -7.0, 1.0]), covariance(rng, 3), arm),
        "position, horizontal": factors.PositionFix(np.array([4.0, -7.0, 1.0]), unmeasured_down, arm, TILTED),
        "heading": factors.Heading(0.4, 0.02, 0.1, TILTED),
        "sun scatter": factors.SunScatter(rank_two(rng), up_north),
        "direction": factors.Direction(BODY_DIRECTION, up_north, np.diag([1e-2, 4e-4]), TILTED[:, 2]),
        "direction, azimuth only": factors.Direction(BODY_DIRECTION, up_north, np.diag([np.inf, 4e-4])),
        "relative pose": factors.RelativePose(random_pose(rng), covariance(rng, 6)),
        **{f"dvl, turn {turn}": dvl(turn) for turn in (0.0, 0.3, 1.5)},
    }


MEASUREMENTS = measurements()
EACH = pytest.mark.parametrize("measurement", MEASUREMENTS.values(), ids=MEASUREMENTS.keys())


def states(measurement: factors.Measurement, near_pi: bool = False) -> list[tuple[gtsam.Pose3, ...]]:
    rng = np.random.default_rng(1)
    drawn = []
    for _ in range(STATES):
        first = random_pose(rng, near_pi)
        if len(measurement.variables) == 1:
            drawn.append((first,))
        else:
            away = gtsam.Pose3(random_rotation(rng, near_pi), rng.normal(size=3) * 3.0)
            measured = measurement.T_ij if hasattr(measurement, "T_ij") else measurement.relative_pose
            drawn.append((first, first.compose(measured).compose(away)))
    return drawn


def values_of(measurement: factors.Measurement) -> list[gtsam.Values]:
    drawn = []
    for state in states(measurement) + states(measurement, near_pi=True):
        values = gtsam.Values()
        for key, pose in zip(KEYS, state, strict=False):
            values.insert(key, pose)
        drawn.append(values)
    return drawn


@EACH
def test_jacobians(measurement: factors.Measurement) -> None:
    factors.check_jacobians(measurement, states(measurement) + states(measurement, near_pi=True), tolerance=1e-6)


@EACH
@pytest.mark.parametrize("loss", [None, gtsam.noiseModel.mEstimator.Huber.Create(1.345)], ids=["gaussian", "huber"])
def test_the_native_factor_equals_the_reference(measurement: factors.Measurement, loss: object) -> None:
    keys = KEYS[: len(measurement.variables)]
    reference, lowered = measurement.reference(keys, loss), measurement.lowered(keys, loss)
    assert not isinstance(lowered, gtsam.CustomFactor)
    factors.check_equivalence(reference, lowered, values_of(measurement), tolerance=1e-9)


@EACH
def test_a_robust_loss_lowers_the_cost_of_an_outlier(measurement: factors.Measurement) -> None:
    keys = KEYS[: len(measurement.variables)]
    plain = measurement.lowered(keys)
    robust = measurement.lowered(keys, gtsam.noiseModel.mEstimator.Huber.Create(1e-3))
    errors = [(plain.error(v), robust.error(v)) for v in values_of(measurement)]
    assert all(r < p for p, r in errors)


# Heading


@pytest.mark.parametrize("heading", [0.0, 1e-16, -1e-16, 90 * DEG, 180 * DEG, 270 * DEG, 33 * DEG])
@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (40 * DEG, 0.0), (0.0, 40 * DEG), (-40 * DEG, -40 * DEG)])
def test_heading_weighs_the_heading_error_and_nothing_else(heading: float, roll: float, pitch: float) -> None:
    sigma, off = 0.5 * DEG, 1e-3
    factor = factors.Heading(heading, sigma, pitch).lowered(KEYS[:1])

    def error(r: float, p: float, h: float) -> float:
        values = gtsam.Values()
        values.insert(KEYS[0], gtsam.Pose3(gtsam.Rot3.RzRyRx(r, p, h), np.zeros(3)))
        return factor.error(values)

    assert error(roll, pitch, heading + off) == pytest.approx(0.5 * (off / sigma) ** 2, rel=1e-5)
    assert error(roll + 0.3, pitch - 0.2, heading) == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize("heading", [0.0, 90 * DEG, 200 * DEG])
def test_heading_is_against_the_local_north(heading: float) -> None:
    R_n_local = gtsam.Rot3.RzRyRx(1e-3, -2e-3, 0.05).matrix()
    pose = gtsam.Pose3(gtsam.Rot3(R_n_local @ gtsam.Rot3.RzRyRx(0.1, 0.2, heading).matrix()), np.zeros(3))
    assert factors.Heading(heading, 0.01, R_n_local=R_n_local).residual(pose) == pytest.approx(0.0, abs=1e-12)


# Sun


def test_direction_is_weighted_in_elevation_and_azimuth_angles() -> None:
    elevation, azimuth, sigmas = 55 * DEG, 120 * DEG, np.array([0.02, 0.003])

    def s(e: float, a: float) -> np.ndarray:
        return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])

    def whitened(e: float, a: float) -> np.ndarray:
        measurement = factors.Direction(s(e, a), s(elevation, azimuth), np.diag(sigmas**2))
        return measurement.noise().whiten(measurement.residual(gtsam.Pose3()))

    off = 1e-5
    assert whitened(elevation + off, azimuth) == pytest.approx([off / sigmas[0], 0.0], abs=1e-6)
    assert whitened(elevation, azimuth + off) == pytest.approx([0.0, off / sigmas[1]], abs=1e-6)


def test_sun_scatter_is_chi_square_with_two_degrees_of_freedom() -> None:
    rng = np.random.default_rng(3)
    pose, s_n = random_pose(rng), np.array([0.36, 0.48, -0.8])
    s_b = pose.rotation().unrotate(s_n)
    E = np.linalg.svd(s_b[None])[2][1:].T
    cov = np.array([[4e-4, 1e-4], [1e-4, 1e-4]])
    squares = []
    for noise in rng.multivariate_normal(np.zeros(2), cov, size=2000):
        seen = s_b + E @ noise
        seen /= np.linalg.norm(seen)
        basis = np.linalg.svd(seen[None])[2][1:].T
        turned = basis @ (basis.T @ E)
        measurement = factors.SunScatter(turned @ np.linalg.inv(cov) @ turned.T, s_n)
        squares.append(np.sum(measurement.noise().whiten(measurement.residual(pose)) ** 2))
    assert np.mean(squares) == pytest.approx(2.0, abs=0.15)
    assert np.var(squares) == pytest.approx(4.0, rel=0.25)


# Depth


def test_depth_from_pressure_follows_teos10() -> None:
    # 10 000 dbar at 30 degrees: 9713.735 m by UNESCO 1983 in its own standard ocean, 9709 m in TEOS-10's.
    assert factors.depth_from_pressure(1e8 + 101_325.0, 30 * DEG) == pytest.approx(9713.7, abs=6.0)
    assert factors.depth_from_pressure([101_325.0], 0.0) == pytest.approx([0.0])
    assert factors.depth_from_pressure(98_066.5, 45 * DEG, surface_pressure=0.0) == pytest.approx(9.73, abs=0.03)


def test_depth_curves_with_the_earth() -> None:
    radius, far = 6_371_000.0, 10_800.0
    vertical = np.array([-far / radius, 0.0, np.sqrt(1.0 - (far / radius) ** 2)])
    surface = np.array([far, 0.0, radius - np.sqrt(radius**2 - far**2)])
    pose = gtsam.Pose3(gtsam.Rot3(), surface + 25.0 * vertical)
    assert factors.Depth(25.0, 0.1, vertical, surface).residual(pose) == pytest.approx(0.0, abs=1e-9)
    assert factors.Depth(25.0, 0.1).residual(pose) == pytest.approx(9.15, abs=0.05)


# Noise


def test_square_roots_reproduce_the_information() -> None:
    rng = np.random.default_rng(5)
    information = rank_two(rng)
    S = sqrt_information(information, rank=2)
    np.testing.assert_allclose(S.T @ S, information, atol=1e-12)
    cov = covariance(rng, 4)
    S = sqrt_information_of_covariance(cov)
    np.testing.assert_allclose(S.T @ S @ cov, np.eye(4), atol=1e-9)


def test_an_infinite_variance_measures_exactly_nothing() -> None:
    S = sqrt_information_of_covariance(np.diag([4.0, np.inf, 1.0]))
    np.testing.assert_array_equal(S, np.diag([0.5, 0.0, 1.0]))


@pytest.mark.parametrize("bad", [np.diag([1.0, -1.0]), np.diag([1.0, np.nan]), np.zeros((2, 2))])
def test_a_bad_covariance_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(ValueError, match="covariance"):
        sqrt_information_of_covariance(bad)


@pytest.mark.parametrize("bad", [np.diag([1.0, -1.0, 1.0]), np.full((3, 3), np.nan)])
def test_a_bad_information_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(ValueError, match="information"):
        sqrt_information(bad)


# Adapter and checks


class Broken(factors.Depth):
    """A depth whose residual or Jacobian can be spoilt."""

    spoil = staticmethod(lambda r: r)
    spoil_jacobian = staticmethod(lambda J: J)

    def residual(self, pose: gtsam.Pose3) -> np.ndarray:
        return self.spoil(super().residual(pose))

    def jacobians(self, pose: gtsam.Pose3) -> tuple[np.ndarray]:
        return (self.spoil_jacobian(super().jacobians(pose)[0]),)


def spoilt(**functions: object) -> Broken:
    broken = type("Spoilt", (Broken,), {name: staticmethod(f) for name, f in functions.items()})
    return broken(1.0, 0.1, l_b=np.array([1.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("functions", "problem"),
    [
        ({"spoil": lambda r: r * np.nan}, r"Spoilt\(x3\): residual is not finite"),
        ({"spoil": lambda r: np.append(r, 0.0)}, r"Spoilt\(x3\): residual has shape \(2,\), expected \(1,\)"),
        ({"spoil_jacobian": lambda J: J[:, :3]}, r"Spoilt\(x3\): Jacobian 0 has shape \(1, 3\)"),
        ({"spoil_jacobian": lambda J: J * np.inf}, r"Spoilt\(x3\): Jacobian 0 is not finite"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_adapter_names_the_factor_that_misbehaves(functions: dict[str, object], problem: str) -> None:
    values = gtsam.Values()
    values.insert(KEYS[0], gtsam.Pose3())
    factor = spoilt(**functions).reference(KEYS[:1])
    with pytest.raises(ValueError, match=problem):
        factor.linearize(values)


def test_the_adapter_counts_the_keys() -> None:
    with pytest.raises(ValueError, match="needs 1 keys, got 2"):
        spoilt().reference(KEYS)


def test_the_checks_find_a_wrong_sign() -> None:
    pose = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, 0.2, 0.3), np.ones(3))
    with pytest.raises(AssertionError, match="Spoilt: Jacobian 0 differs"):
        factors.check_jacobians(spoilt(spoil_jacobian=lambda J: -J), [(pose,)])
    values = gtsam.Values()
    values.insert(KEYS[0], pose)
    wrong = spoilt(spoil=lambda r: r + 1e-3).reference(KEYS[:1])
    with pytest.raises(AssertionError, match="error differs"):
        factors.check_equivalence(wrong, factors.Depth(1.0, 0.1, l_b=np.array([1.0, 0.0, 0.0])).lowered(KEYS), [values])


def test_a_measurement_without_jacobians_gets_numerical_ones() -> None:
    class Range(factors.Measurement):
        variables = ("Pose3",)

        def residual(self, pose: gtsam.Pose3) -> np.ndarray:
            return np.array([np.linalg.norm(pose.translation()) - 2.0])

        def noise(self) -> gtsam.noiseModel.Gaussian:
            return gtsam.noiseModel.Isotropic.Sigma(1, 0.1)

        def lowered(self, keys: tuple[int, ...], loss: object = None) -> gtsam.NonlinearFactor:
            raise NotImplementedError

    graph = gtsam.NonlinearFactorGraph()
    graph.add(Range().reference(KEYS[:1]))
    graph.add(gtsam.PriorFactorPose3(KEYS[0], gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 100.0)))
    values = gtsam.Values()
    values.insert(KEYS[0], gtsam.Pose3(gtsam.Rot3(), np.array([3.0, 4.0, 0.0])))
    solution = gtsam.GaussNewtonOptimizer(graph, values).optimize().atPose3(KEYS[0])
    assert np.linalg.norm(solution.translation()) == pytest.approx(2.0, abs=1e-4)
