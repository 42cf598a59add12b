"""A measurement model at its moment, of which parts of the state it is: what graph and filters both take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

import factors
from uwgraph.types import FloatArray

Role = Literal["pose", "velocity", "bias", "dvl", "node"]
"""Part of the state: ``dvl`` is the Doppler log's calibration, ``node`` a pose remembered from earlier."""


@dataclass(frozen=True, eq=False)
class Observed:
    """One measurement."""

    t_ns: int
    """When it was made, on the dive's clock."""
    kind: str
    """The sensor: measurements of one kind share their noise statistics."""
    model: factors.Measurement
    roles: Sequence[Role] = ("pose",)
    """What each of the model's variables is."""
    node_ns: int = 0
    """The moment of the remembered pose, where there is one among the roles."""

    @cached_property
    def whitener(self) -> FloatArray:
        """W, shape (m, size of the residual): W r is of unit variance where the stated noise is true.

        What is not measured has no row.
        """
        W = np.asarray(self.model.noise().R())
        return W[np.any(W != 0.0, axis=1)]
