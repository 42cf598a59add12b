"""The sun from polarization images: sign, tilt, consistency, and everything that must be refused."""

from dataclasses import replace

import numpy as np
import pytest
from polar_sky import CLEAR, POLARIZERS, SENSOR, fisheye, photograph, sun_at

from uwgraph.errors import DataError
from uwgraph.frames import matrix_from_rph, wrap_pi
from uwgraph.simulate.scene import OccluderSettings, Scene
from uwgraph.sun.observation import SunFlag
from uwgraph.sun.polarization import Settings, estimate
from uwgraph.sun.stokes import from_channels

CAMERA = fisheye()
DEEP = fisheye(96, 44.0)
TILTED = CAMERA.R_bs @ matrix_from_rph(np.array([0.25, 0.25, 0.0]))


def found(counts, view, settings=None):
    return estimate(from_channels(counts, POLARIZERS, SENSOR), view, settings)


def heading_error_deg(sun, azimuth, heading):
    return abs(np.degrees(wrap_pi(sun.heading(azimuth) - heading)))


@pytest.mark.parametrize("heading", [0.3, 2.4, -1.8])
@pytest.mark.parametrize("depth", [None, 2.0])
def test_the_heading_has_the_right_sign(heading, depth):
    counts, view = photograph(CAMERA if depth is None else DEEP, (0.0, 0.0, heading), sun_at(1.1, 0.8), depth=depth)
    sun = found(counts, view).observation
    assert sun.ok, sun.flags
    assert heading_error_deg(sun, 1.1, heading) < 0.1


@pytest.mark.parametrize(("roll", "pitch"), [(0.17, 0.0), (0.0, -0.17), (-0.1, 0.15)])
@pytest.mark.parametrize("depth", [None, 2.0])
def test_tilt_does_not_matter(roll, pitch, depth):
    counts, view = photograph(CAMERA if depth is None else DEEP, (roll, pitch, 0.5), sun_at(-0.6, 0.9), depth=depth)
    sun = found(counts, view).observation
    assert sun.ok, sun.flags
    assert heading_error_deg(sun, -0.6, 0.5) < (0.1 if depth is None else 0.3)


def test_the_almanac_is_not_needed():
    counts, view = photograph(CAMERA, (0.05, 0.1, 0.5), sun_at(-0.6, 0.9))
    estimated = found(counts, replace(view, sun_zenith=None))
    assert estimated.observation.ok
    assert estimated.solution is not None
    assert estimated.solution.vote is None
    assert heading_error_deg(estimated.observation, -0.6, 0.5) < 0.1


def test_the_arrays_for_pictures_fit_together():
    counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(-0.6, 0.9))
    estimated = found(counts, view)
    assert estimated.sky is not None
    assert estimated.solution is not None
    count = len(estimated.pixels)
    assert len(estimated.sky) == len(estimated.solution.fit.residual) == len(estimated.solution.fit.trust) == count
    assert estimated.pixels.max() < estimated.image.I.size
    assert estimated.observation.quality > 0.8


def test_neutral_points_are_found_beside_the_sun():
    """With half the sky hidden they would bend the heading by about a degree."""
    hidden = (OccluderSettings(shape="sector", share=0.6, brightness=0.3),)
    errors = []
    for seed in range(4):
        s_n = sun_at(0.4, np.radians(45.0))
        counts, view = photograph(CAMERA, (0.1, 0.05, 0.5), s_n, Scene(sun=0.0, wind=0.0, occluders=hidden), seed=seed)
        estimated = found(counts, view)
        errors.append(heading_error_deg(estimated.observation, 0.4, 0.5))
        assert 0.01 < estimated.unknowns.twice < 0.04
    assert np.median(errors) < 0.2


def test_the_information_is_consistent_over_noise_and_neutral_points():
    nees = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        rph = (*rng.uniform(-0.15, 0.15, 2), rng.uniform(-3.0, 3.0))
        s_n = sun_at(rng.uniform(-3.0, 3.0), rng.uniform(0.4, 1.2))
        scene = Scene(sun=0.0, wind=0.0, neutral_deg=rng.uniform(5.0, 20.0))
        counts, view = photograph(CAMERA, rph, s_n, scene, seed=seed)
        sun = found(counts, view).observation
        s_b = matrix_from_rph(np.array(rph)).T @ s_n
        nees.append(s_b @ sun.information_b @ s_b / 2.0)
    assert 0.02 < np.mean(nees) < 1.5  # the floor and the sky's own error stand behind every one of these images


def test_information_has_rank_two_and_belongs_to_the_covariance():
    counts, view = photograph(CAMERA, (0.0, 0.1, 0.5), sun_at(-0.6, 0.9))
    sun = found(counts, view).observation
    assert np.allclose(sun.information_b @ sun.s_b, 0.0, atol=1e-6 * np.abs(sun.information_b).max())
    assert np.allclose(np.linalg.pinv(sun.cov_b, rcond=1e-6), sun.information_b, rtol=1e-6)


def test_uncertain_tilt_widens_what_comes_through_the_surface():
    """The spread of directions over wrong tilts is the spread that is added."""
    counts, view = photograph(DEEP, (0.0, 0.0, 0.5), sun_at(-0.6, 0.9), depth=2.0)
    tilt = np.radians(1.0)
    sure, unsure = (found(counts, replace(view, tilt_sigma=sigma)).observation for sigma in (0.0, tilt))
    added = unsure.cov_b - sure.cov_b
    moved = []
    for axis in np.eye(3)[:2]:
        up_b = view.up_b + tilt * axis
        moved.append(found(counts, view.tilted(up_b / np.linalg.norm(up_b))).observation.s_b - sure.s_b)
    spread = np.stack(moved).T @ np.stack(moved)
    assert np.sqrt(np.trace(added)) == pytest.approx(np.sqrt(np.trace(spread)), rel=0.4)
    assert np.degrees(np.sqrt(np.trace(added))) > 0.2


def test_a_sun_on_the_horizon_reports_both_modes():
    s_n = sun_at(1.0, np.radians(89.7))
    counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), s_n)
    sun = found(counts, replace(view, tilt_sigma=np.radians(0.5))).observation
    assert sun.flags & SunFlag.AMBIGUOUS
    assert sun.other_b is not None
    s_b = matrix_from_rph(np.array([0.0, 0.0, 0.5])).T @ s_n
    assert max(sun.s_b @ s_b, sun.other_b @ s_b) > np.cos(np.radians(1.0))


def test_half_a_false_sky_is_never_a_confident_wrong_sun():
    for seed in range(6):
        body = OccluderSettings(shape="wall", share=0.6, clutter="false_sun", brightness=1.0, dop=0.6)
        counts, view = photograph(
            CAMERA, (0.0, 0.1, 0.5), sun_at(0.4, 0.8), Scene(sun=0.0, wind=0.0, occluders=(body,)), seed=seed
        )
        sun = found(counts, view).observation
        assert not sun.ok or heading_error_deg(sun, 0.4, 0.5) < 5.0 * np.degrees(sun.azimuth_sigma)


def test_depolarized_water_is_allowed_for():
    murky = CLEAR.model_copy(update={"attenuation": 0.3, "albedo": 0.55})
    counts, view = photograph(DEEP, (0.05, 0.0, 0.5), sun_at(-0.6, 0.9), murky, depth=4.0)
    estimated = found(counts, view)
    assert estimated.unknowns.log_kappa > np.log(1.2)
    assert heading_error_deg(estimated.observation, -0.6, 0.5) < 0.3


class TestRefused:
    rng = np.random.default_rng(0)

    def flags(self, light, view=None):
        counts = [self.rng.poisson(SENSOR.gain * x) / SENSOR.gain for x in light]
        counts = [np.minimum(c, 4095).astype(np.uint16) for c in counts]
        _, seen = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(0.0, 0.9))
        return found(counts, view or seen).observation

    def test_black(self):
        sun = self.flags([np.full((96, 96), 0.2)] * 4)
        assert sun.flags & SunFlag.DARK
        assert np.isnan(sun.s_b).all()

    def test_saturated(self):
        assert self.flags([np.full((96, 96), 9000.0)] * 4).flags & SunFlag.SATURATED

    def test_overcast(self):
        sun = self.flags([np.full((96, 96), 2000.0)] * 4)
        assert sun.flags & SunFlag.UNPOLARIZED
        assert sun.flags & SunFlag.UNIFORM

    def test_unpolarized_with_structure(self):
        slope = np.linspace(500.0, 3000.0, 96)[None] * np.ones((96, 1))
        sun = self.flags([slope] * 4)
        assert sun.flags & SunFlag.UNPOLARIZED
        assert not sun.flags & SunFlag.UNIFORM

    def test_a_polarizing_sheet_over_the_lens(self):
        light = [2000.0 * np.cos(beta - 0.4) ** 2 * np.ones((96, 96)) for beta in POLARIZERS]
        assert not self.flags(light).ok

    def test_polarization_at_random(self):
        angle = self.rng.uniform(0.0, np.pi, (96, 96))
        light = [1000.0 * (1.0 + 0.5 * np.cos(2.0 * (angle - beta))) for beta in POLARIZERS]
        assert not self.flags(light).ok

    def test_upside_down(self):
        counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(0.0, 0.9))
        sun = found(counts, view.tilted(-view.up_b)).observation
        assert sun.flags & SunFlag.SMALL_WINDOW

    def test_time_or_place_are_wrong(self):
        counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(0.0, 0.9))
        sun = found(counts, replace(view, sun_zenith=0.6)).observation
        assert sun.flags & SunFlag.ZENITH_DISAGREES

    def test_night(self):
        counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(0.0, 0.9))
        sun = found(counts, replace(view, sun_zenith=np.radians(95.0))).observation
        assert sun.flags & SunFlag.NIGHT

    def test_sun_overhead(self):
        counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(0.0, np.radians(2.0)))
        assert found(counts, view).observation.flags & SunFlag.NEAR_ZENITH

    @pytest.mark.parametrize("change", [{"analyser": "sheet"}, {"f": (25.0, 25.0)}, {"R_bs": TILTED}])
    def test_wrong_camera_file(self, change):
        """Whatever a wrong calibration leads to, it is no confident wrong sun."""
        counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(0.7, 0.9))
        sun = found(counts, replace(view, camera=replace(CAMERA, **change))).observation
        assert not sun.ok

    def test_image_of_another_size(self):
        counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(0.0, 0.9))
        with pytest.raises(DataError, match="pixels and the camera"):
            found([c[:80] for c in counts], view)


def test_settings_are_heard():
    counts, view = photograph(CAMERA, (0.0, 0.0, 0.5), sun_at(0.0, 0.9))
    narrow = found(counts, view, Settings(max_zenith_air=np.radians(30.0)))
    assert len(narrow.pixels) < 0.6 * len(found(counts, view).pixels)
