"""Global descriptors of a neural network that the user supplies as an ONNX file, run by OpenCV."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from uwgraph.dive.rig import Finite, Positive, Settings
from uwgraph.errors import DataError
from uwgraph.places.enhance import Enhancement, Grey, enhance

Side = Annotated[int, Field(ge=8, le=4096)]
MAX_BYTES: Final = 2 << 30
MAX_OUTPUT: Final = 1 << 20
"""Numbers of a descriptor."""


class OnnxSettings(Settings):
    """A network and what it expects; the defaults are those of networks trained on ImageNet."""

    path: str
    """ONNX file: one input (1, 3, height, width), one output of any shape, which is flattened."""
    width: Side = 224
    height: Side = 224
    enhancement: Enhancement | None = None
    """Grey image given as three equal channels; None: the colours as they are."""
    mean: tuple[Finite, Finite, Finite] = (0.485, 0.456, 0.406)
    """Red, green, blue on a scale of 0 to 1; subtracted."""
    std: tuple[Positive, Positive, Positive] = (0.229, 0.224, 0.225)
    """By which is divided then."""
    contrast: Positive = 4.0
    """An image whose standard deviation is below this many of 255 counts has no descriptor."""


@dataclass(frozen=True, eq=False)
class OnnxDescriber:
    """The flattened output of a network, of unit length."""

    settings: OnnxSettings
    net: Any
    checksum: str
    """SHA-256 of the file."""
    size: int

    @classmethod
    def open(cls, settings: OnnxSettings) -> OnnxDescriber:
        """Read the network and run it once.

        Raises
        ------
        DataError
            When the file is missing or too large, or OpenCV cannot run it.
        """
        path, where = Path(settings.path), settings.path
        try:
            if path.stat().st_size > MAX_BYTES:
                raise DataError(f"is larger than {MAX_BYTES} bytes", where=where, remedy="use a smaller network")
            content = path.read_bytes()
        except OSError as error:
            raise DataError(
                f"cannot be read ({error.strerror})", where=where, remedy="check the path of the network"
            ) from error
        try:
            net = cv2.dnn.readNetFromONNX(np.frombuffer(content, np.uint8))
            size = _run(net, np.zeros((1, 3, settings.height, settings.width), np.float32)).size
        except (cv2.error, SystemError) as error:
            raise DataError(
                f"is no network that OpenCV can run ({str(error)[:200]})",
                where=where,
                remedy="export to ONNX with a fixed input size and plain operators; check width and height",
            ) from error
        if not 1 <= size <= MAX_OUTPUT:
            raise DataError(f"gives {size} numbers", where=where, remedy="use a network that ends in a descriptor")
        return cls(settings, net, hashlib.sha256(content).hexdigest(), size)

    def describe(self, image: NDArray[Any], mask: Grey | None = None) -> NDArray[np.float32] | None:
        """See :class:`uwgraph.places.describe.Describer`; what the mask hides is made grey."""
        grey = enhance(image, self.settings.enhancement or "none", mask)
        if min(grey.shape) < 2 or grey.std() < self.settings.contrast:
            return None
        colour = _colour(image, grey) if self.settings.enhancement is None else cv2.merge([grey] * 3)
        if mask is not None and mask.shape == grey.shape:
            colour = np.where(mask[..., None] > 0, colour, np.uint8(128))
        output = _run(self.net, self._blob(colour))
        length = float(np.linalg.norm(output))
        return output / np.float32(length) if np.isfinite(length) and length > 0.0 else None

    def _blob(self, colour: NDArray[Any]) -> NDArray[np.float32]:
        """The image as the network wants it, shape (1, 3, height, width)."""
        size = (self.settings.width, self.settings.height)
        small = cv2.resize(colour, size, interpolation=cv2.INTER_AREA)
        rgb = small[..., ::-1].astype(np.float32) / 255.0
        normal = (rgb - np.array(self.settings.mean, np.float32)) / np.array(self.settings.std, np.float32)
        return np.ascontiguousarray(normal.transpose(2, 0, 1)[None], dtype=np.float32)


def _colour(image: NDArray[Any], grey: Grey) -> NDArray[Any]:
    """Blue, green, red of 8 bits, shape (H, W, 3)."""
    if image.ndim == 3 and image.shape[2] == 3:
        return image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)
    return cv2.merge([grey] * 3)


def _run(net: Any, blob: NDArray[np.float32]) -> NDArray[np.float32]:
    net.setInput(blob)
    return np.asarray(net.forward(), dtype=np.float32).ravel()
