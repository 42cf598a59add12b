"""One protocol for every measurement, and the wrapper that makes any of them a GTSAM factor.

A measurement is written once as a NumPy residual. ``reference`` wraps it as a ``CustomFactor`` (slow: right for tests
and experiments); ``lowered`` is the native C++ factor that equals it. :mod:`factors.check` holds the two together.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import gtsam
import numpy as np

from factors.lie import FloatArray
from factors.noise import robust

Loss = gtsam.noiseModel.mEstimator.Base
"""A robust loss, such as ``gtsam.noiseModel.mEstimator.Huber.Create(1.345)``."""

VALUE_AT = {
    "Pose3": gtsam.Values.atPose3,
    "Vector": gtsam.Values.atVector,
    "ConstantBias": gtsam.Values.atConstantBias,
}


class Poses(NamedTuple):
    """M poses T_nb as arrays: what stands for a ``Pose3`` where many states are asked at once."""

    R_nb: FloatArray
    """Shape (M, 3, 3)."""
    p_n: FloatArray
    """Shape (M, 3), m."""


class Measurement(ABC):
    """A residual with Gaussian noise over one or more variables."""

    variables: ClassVar[tuple[str, ...]]
    """Types of the variables in the order of the keys: names in ``VALUE_AT``."""

    @abstractmethod
    def residual(self, *variables: Any) -> FloatArray:
        """Unwhitened residual, shape (m,): prediction minus measurement, unless GTSAM's own factor says otherwise."""

    @abstractmethod
    def noise(self) -> gtsam.noiseModel.Gaussian:
        """Noise of the residual, dimension m; its information may be singular."""

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        """The native factor that equals :meth:`reference` and is faster; the reference itself where there is none."""
        return self.reference(keys, loss)

    def jacobians(self, *variables: Any) -> tuple[FloatArray, ...]:
        """Derivative of the residual by each variable, right perturbation; numerical unless overridden."""
        return numerical_jacobians(self, *variables)

    def residuals(self, *variables: Any) -> FloatArray:
        """:meth:`residual` of M states at once, shape (M, m); one by one unless overridden.

        Poses come as :class:`Poses`, vectors as arrays (M, d), biases as arrays (M, 6), accelerometer then gyro.
        """
        each = map(_one_by_one, self.variables, variables)
        return np.stack([self.residual(*states) for states in zip(*each, strict=True)])

    def reference(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.CustomFactor:
        """The measurement as a Python factor; see :func:`custom_factor`."""
        return custom_factor(self, keys, loss)


class ArrayMeasurement(Measurement):
    """A measurement whose residual is written for many states at once, for filters that spread sigma points."""

    @abstractmethod
    def residuals(self, *variables: Any) -> FloatArray: ...

    def residual(self, *variables: Any) -> FloatArray:
        row: FloatArray = self.residuals(*map(_as_arrays, variables))[0]
        return row


def _as_arrays(variable: Any) -> Any:
    """One GTSAM variable as arrays with a leading axis of length 1."""
    if isinstance(variable, gtsam.Pose3):
        return Poses(variable.rotation().matrix()[None], variable.translation()[None])
    return np.asarray(variable.vector() if isinstance(variable, gtsam.imuBias.ConstantBias) else variable)[None]


def _one_by_one(kind: str, variables: Any) -> list[Any]:
    """M states of one variable as GTSAM has them."""
    if kind == "Pose3":
        return [gtsam.Pose3(gtsam.Rot3(R), p) for R, p in zip(*variables, strict=True)]
    if kind == "ConstantBias":
        return [gtsam.imuBias.ConstantBias(b[:3], b[3:]) for b in variables]
    return list(variables)


def retract(variable: Any, delta: FloatArray) -> Any:
    """The variable moved by a tangent vector, as GTSAM does it."""
    return variable.retract(delta) if hasattr(variable, "retract") else np.add(variable, delta)


def numerical_jacobians(measurement: Measurement, *variables: Any, step: float = 1e-5) -> tuple[FloatArray, ...]:
    """Central differences of the residual by each variable, through its retraction."""

    def column(n: int, delta: FloatArray) -> FloatArray:
        plus, minus = (
            measurement.residual(*variables[:n], retract(variables[n], s * delta), *variables[n + 1 :])
            for s in (step, -step)
        )
        slope: FloatArray = (plus - minus) / (2.0 * step)
        return slope

    return tuple(
        np.stack([column(n, direction) for direction in np.eye(dimension(x))], axis=1) for n, x in enumerate(variables)
    )


def dimension(variable: Any) -> int:
    """Length of the variable's tangent vector."""
    return 6 if isinstance(variable, gtsam.Pose3 | gtsam.imuBias.ConstantBias) else len(variable)


def custom_factor(measurement: Measurement, keys: Sequence[int], loss: Loss | None = None) -> gtsam.CustomFactor:
    """Wrap a measurement as a ``CustomFactor``.

    Python inside a GTSAM optimiser costs a copy of all values per call: for graphs of more than some hundred variables
    use :meth:`Measurement.lowered`.

    Raises
    ------
    ValueError
        When the number of keys is wrong; and, while the factor is evaluated, when a residual or a Jacobian has the
        wrong shape or is not finite. The message names the measurement and its keys.
    """
    named = f"{type(measurement).__name__}({', '.join(gtsam.DefaultKeyFormatter(k) for k in keys)})"
    if len(keys) != len(measurement.variables):
        raise ValueError(f"{named}: needs {len(measurement.variables)} keys, got {len(keys)}")
    model = measurement.noise()
    m = model.dim()

    def check(array: Any, shape: tuple[int, ...], what: str) -> FloatArray:
        checked: FloatArray = np.asarray(array, dtype=np.float64)
        if checked.shape != shape:
            raise ValueError(f"{named}: {what} has shape {checked.shape}, expected {shape}")
        if not np.isfinite(checked).all():
            raise ValueError(f"{named}: {what} is not finite")
        return checked

    def error(_: gtsam.CustomFactor, values: gtsam.Values, H: list[FloatArray] | None) -> FloatArray:
        x = [VALUE_AT[kind](values, key) for kind, key in zip(measurement.variables, keys, strict=True)]
        if H is not None:
            for n, J in enumerate(measurement.jacobians(*x)):
                H[n] = np.asfortranarray(check(J, (m, dimension(x[n])), f"Jacobian {n}"))
        return check(measurement.residual(*x), (m,), "residual")

    return gtsam.CustomFactor(robust(model, loss), list(keys), error)
