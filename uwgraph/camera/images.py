"""Image files, read with suspicion."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from uwgraph.errors import DataError

MAX_PIXELS: Final = 150_000_000
Counts = NDArray[Any]
"""An image as it is in the file: whole numbers, shape (H, W) or (H, W, 3) in the order blue, green, red."""


def read_image(path: str | Path) -> Counts:
    """Read one image as it was recorded: 8 or 16 bits, no rotation by its tags, no transparency.

    Raises
    ------
    DataError
        When the file is missing, damaged, too large, or not of whole numbers.
    """
    file = Path(path)
    where = str(file)
    if not file.is_file():
        raise DataError("there is no such image", where=where, remedy="check the path")
    try:
        with Image.open(file) as header:
            width, height = header.size
            if header.format in ("JPEG", "MPO") and width * height <= MAX_PIXELS:
                header.load()  # OpenCV fills the rest of a file that is cut off
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError) as error:
        raise DataError(
            f"is no image that can be read ({str(error)[:100]})", where=where, remedy="use a whole PNG, TIFF or JPEG"
        ) from error
    if width * height > MAX_PIXELS:
        raise DataError(f"has {width} x {height} pixels", where=where, remedy=f"at most {MAX_PIXELS} are read")
    try:
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise DataError(f"cannot be decoded ({error.err})", where=where, remedy="record or copy it again") from error
    if image is None:
        raise DataError("cannot be decoded: damaged or cut off", where=where, remedy="record or copy it again")
    if image.dtype not in (np.uint8, np.uint16):
        raise DataError(f"holds {image.dtype}", where=where, remedy="8 or 16 bit whole numbers are read")
    return image[:, :, :3] if image.ndim == 3 and image.shape[2] == 4 else image
