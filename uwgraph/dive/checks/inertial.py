"""The IMU by itself: range, resolution, gravity, signs of the gyro, rest, noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uwgraph.dive.checks.finding import Finding, Level, Subject
from uwgraph.dive.checks.vertical import gyro_gains, mean_vectors
from uwgraph.frames import OMEGA_EARTH, normal_gravity
from uwgraph.types import FloatArray, Imu

AXES = "xyz"
GRAVITY = 0.1
"""m/s^2, what the norm may be off besides the accelerometer's bias."""
TILT = np.radians(45.0)
"""Further than this from upright on average is taken for a wrong frame."""
MOUNTINGS = {
    (2, 1): "rotation_deg = [180, 0, 0] (an FLU sensor)",
    (0, 1): "rotation_deg = [0, 90, 0]",
    (0, -1): "rotation_deg = [0, -90, 0]",
    (1, 1): "rotation_deg = [-90, 0, 0]",
    (1, -1): "rotation_deg = [90, 0, 0]",
}
"""Where the mean specific force points (axis, sign) and the roll, pitch, yaw that bring it to -z."""
OPTIMISTIC, PESSIMISTIC = 3.0, 10.0
WINDOW_S = 10.0


def check_imu(subject: Subject) -> Iterator[Finding]:
    """Everything that the IMU says about itself."""
    imu = subject.dive.imu
    if imu is None or len(imu) < 2:
        return
    if not (np.isfinite(imu.f_s).all() and np.isfinite(imu.w_s).all()):
        yield Finding("error", "imu", "finite", "samples are not finite", "remove the rows, or repair them")
        return
    yield from _range(subject, imu)
    yield from _gravity(subject, imu)
    yield from _gyro_sign(subject, imu)
    yield from _rest(subject, imu)
    yield from _noise(subject, imu)


def _range(subject: Subject, imu: Imu) -> Iterator[Finding]:
    rig = subject.dive.rig.imu
    worst: list[Finding] = []
    for label, data, full in (("f", imu.f_s, rig.accel_range), ("w", imu.w_s, rig.gyro_range)):
        for axis, x in zip(AXES, data.T, strict=True):
            name = f"{label}_{axis}"
            top = float(np.abs(x).max())
            if np.ptp(x) == 0:
                worst.append(
                    Finding(
                        "error", "imu", "range", f"{name} never changes from {x[0]:g}", "the axis is dead or left out"
                    )
                )
                continue
            pinned = np.abs(x) > top * (1 - 1e-9)
            run = int((pinned[:-1] & pinned[1:]).sum())
            clipped = int((np.abs(x) >= 0.99 * full).sum())
            typical = float(np.percentile(np.abs(x - np.median(x)), 99))
            if clipped or (run >= 3 and len(np.unique(x)) > 100 and abs(top - abs(np.median(x))) > typical):
                count = max(clipped, int(pinned.sum()))
                message = f"{name} stands at its limit of {top:.4g} in {count} samples"
                remedy = "raise the sensor's range; what was cut off is lost, so raise its noise in the rig"
                worst.append(Finding("warning", "imu", "range", message, remedy, top, full))
    yield from worst or [Finding("ok", "imu", "range", "no axis is saturated or dead")]


def _gravity(subject: Subject, imu: Imu) -> Iterator[Finding]:
    dive, rig = subject.dive, subject.dive.rig.imu
    force_b = mean_vectors(imu.t_s, imu.f_s @ rig.R_bs.T, 1.0)
    norm = float(np.median(np.linalg.norm(force_b, axis=1)))
    expected = float(normal_gravity(dive.origin.lat, 0.0))
    limit = GRAVITY + 3 * rig.accel_bias_sigma
    if not 0.7 < norm / expected < 1.4:
        looks = (
            "looks like g: multiply by 9.80665"
            if 0.7 < norm < 1.4
            else "f is specific force in m/s^2, gravity included"
        )
        message = f"the specific force has a norm of {norm:.4g} m/s^2 instead of {expected:.4g}"
        yield Finding("error", "imu", "gravity norm", message, looks, norm, expected)
        return
    level: Level = "warning" if abs(norm - expected) > limit else "ok"
    remedy = (
        "calibrate the accelerometer's scale and bias, or raise rig.imu.accel_bias_sigma" if level == "warning" else ""
    )
    message = f"norm {norm:.4f} m/s^2, normal gravity {expected:.4f}"
    yield Finding(level, "imu", "gravity norm", message, remedy, norm - expected, limit)

    mean = force_b.mean(axis=0)
    tilt = float(np.arccos(np.clip(-mean[2] / np.linalg.norm(mean), -1, 1)))
    if tilt > TILT:
        axis = int(np.abs(mean).argmax())
        remedy = MOUNTINGS.get((axis, int(np.sign(mean[axis]))), "find the mounting")
        message = (
            f"the mean specific force in the body is ({mean[0]:.2f}, {mean[1]:.2f}, {mean[2]:.2f}), not (0, 0, -9.8)"
        )
        yield Finding("error", "imu", "gravity axis", message, f"rig.imu.{remedy}, then check the yaw", tilt, TILT)
    else:
        message = f"the mean specific force is {np.degrees(tilt):.1f} deg from -z"
        yield Finding("ok", "imu", "gravity axis", message, value=tilt, limit=TILT)


def _gyro_sign(subject: Subject, imu: Imu) -> Iterator[Finding]:
    gain, sigma = gyro_gains(imu, subject.dive.rig.imu.R_bs)
    seen = sigma < 0.1
    wrong = [AXES[k] for k in range(3) if seen[k] and gain[k] < -0.3]
    rms = float(np.sqrt(np.mean(np.sum(imu.w_s**2, axis=1))))
    gains = ", ".join(f"{AXES[k]} {gain[k]:.2f}" for k in range(3) if seen[k])
    if not seen.any():
        yield Finding("info", "imu", "gyro sign", "the vertical does not move enough to tell")
    elif wrong:
        whole = len(wrong) == int(seen.sum())
        remedy = (
            "the frame is left-handed (negate y of accelerometer and gyro), or every gyro axis has the wrong sign"
            if whole and len(wrong) > 1
            else f"negate {' and '.join('w_' + a for a in wrong)}"
        )
        message = f"the gyro turns against the accelerometer's vertical about {', '.join(wrong)} (gains: {gains})"
        yield Finding("error", "imu", "gyro sign", message, remedy, float(gain[seen].min()), 0.0)
    elif rms > 1.0 and 0.7 < np.median(gain[seen]) / np.radians(1) < 1.4:
        message = f"the vertical turns 57 times slower than the gyro says (gains: {gains})"
        yield Finding("error", "imu", "gyro units", message, "looks like deg/s: multiply by pi/180", rms, 1.0)
    elif np.abs(gain[seen]).max() < 0.3:
        message = f"the specific force does not follow the vertical, its signs cannot be told (gains: {gains})"
        yield Finding("info", "imu", "gyro sign", message)
    else:
        yield Finding("ok", "imu", "gyro sign", f"the vertical turns as the gyro says (gains: {gains})")


def _rest(subject: Subject, imu: Imu) -> Iterator[Finding]:
    rig = subject.dive.rig.imu
    rate = 1.0 / float(np.median(np.diff(imu.t_s)))
    windows = _windows(imu.w_s, round(WINDOW_S * rate))
    forces = _windows(imu.f_s, round(WINDOW_S * rate))
    quiet = (windows.std(axis=1) < 3 * rig.gyro_noise_density * np.sqrt(rate)).all(axis=1)
    quiet &= (forces.std(axis=1) < 3 * rig.accel_noise_density * np.sqrt(rate)).all(axis=1)
    if not quiet.any():
        yield Finding("info", "imu", "gyro bias", "the vehicle never rests, the bias cannot be read off")
        return
    bias = windows[quiet].mean(axis=(0, 1))
    size = float(np.abs(bias).max())
    limit = 3 * rig.gyro_bias_sigma + OMEGA_EARTH + 3 * rig.gyro_noise_density / np.sqrt(WINDOW_S * quiet.sum())
    seconds = WINDOW_S * int(quiet.sum())
    message = f"mean rate at rest ({seconds:.0f} s): {', '.join(f'{b:.2e}' for b in bias)} rad/s, Earth rate included"
    if size > limit:
        remedy = "subtract it from the log, or raise rig.imu.gyro_bias_sigma"
        yield Finding("warning", "imu", "gyro bias", message, remedy, size, limit)
    else:
        yield Finding("ok", "imu", "gyro bias", message, value=size, limit=limit)


def _noise(subject: Subject, imu: Imu) -> Iterator[Finding]:
    rig = subject.dive.rig.imu
    rate = 1.0 / float(np.median(np.diff(imu.t_s)))
    for label, data, stated in (("accel", imu.f_s, rig.accel_noise_density), ("gyro", imu.w_s, rig.gyro_noise_density)):
        density = noise_densities(data, rate)
        fast, least = float(density[0]), float(density.min())
        name, unit = f"{label}_noise_density", "m/s^2/sqrt(Hz)" if label == "accel" else "rad/s/sqrt(Hz)"
        message = (
            f"{label} noise {fast:.2e} {unit} between samples, least {least:.2e} over time; the rig says {stated:.2e}"
        )
        if least < stated / PESSIMISTIC:
            remedy = f"lower rig.imu.{name}: the gyro's and accelerometer's word would count for too little"
            yield Finding("warning", "imu", f"{label} noise", message, remedy, least / stated, 1 / PESSIMISTIC)
        elif least > stated * OPTIMISTIC:
            remedy = f"raise rig.imu.{name} to {least:.1e}, unless the vehicle shakes that much"
            yield Finding("warning", "imu", f"{label} noise", message, remedy, least / stated, OPTIMISTIC)
        elif fast > stated * OPTIMISTIC:
            yield Finding(
                "info", "imu", f"{label} noise", f"{message}: vibration, which averages out", value=fast / stated
            )
        else:
            yield Finding("ok", "imu", f"{label} noise", message, value=fast / stated, limit=OPTIMISTIC)


def noise_densities(x: FloatArray, rate: float) -> FloatArray:
    """White-noise density, largest of three axes, seen at averaging times of 1, 2, 4, ... samples up to half a second.

    From second differences of averages over m samples, whose variance is 6 sigma^2 / m for white noise; motion and
    vibration only add. Of all windows of ten seconds the quietest tenth counts.
    """
    densities = []
    m = 1
    while m == 1 or m <= rate / 2:
        means = x[: len(x) // m * m].reshape(-1, m, x.shape[1]).mean(axis=1)
        second = np.diff(means, n=2, axis=0)
        windows = _windows(second, max(round(WINDOW_S * rate / m), 8))
        variance = np.percentile((windows**2).mean(axis=1), 10, axis=0) / 6.0
        densities.append(float(np.sqrt(variance.max() * m / rate)))
        m *= 2
    return np.array(densities)


def _windows(x: FloatArray, length: int) -> FloatArray:
    """The samples cut into windows, shape (windows, length, 3); one short window where there are too few."""
    length = min(max(length, 1), len(x))
    return x[: len(x) // length * length].reshape(-1, length, x.shape[1])
