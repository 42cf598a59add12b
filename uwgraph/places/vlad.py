"""VLAD: what the features of an image are beside the words of a vocabulary (Jegou et al., CVPR 2010)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import MiniBatchKMeans

from uwgraph.errors import DataError
from uwgraph.places.local import LocalFeatures

MAX_SAMPLES: Final = 200_000
"""Features that the words are learnt from, at most."""


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """Visual words: centres of clusters of local descriptors."""

    words: NDArray[np.float32]
    """Shape (K, D); D is 128 for RootSIFT and 256 for the bits of ORB."""

    @classmethod
    def learn(cls, features: Sequence[LocalFeatures], words: int = 64, random_state: int = 0) -> Vocabulary:
        """The vocabulary of the features of many images, by k-means.

        Raises
        ------
        DataError
            When there are fewer features than words.
        """
        samples = np.concatenate([as_floats(f.descriptors) for f in features]) if features else np.zeros((0, 1))
        if len(samples) < 2 * words:
            raise DataError(
                f"{len(samples)} features are too few for {words} words",
                where="vocabulary",
                remedy="give more or sharper images, or fewer words",
            )
        if len(samples) > MAX_SAMPLES:
            samples = np.random.default_rng(random_state).choice(samples, MAX_SAMPLES, replace=False)
        means = MiniBatchKMeans(words, batch_size=4096, n_init=3, random_state=random_state).fit(samples)
        return cls(means.cluster_centers_.astype(np.float32))

    @property
    def size(self) -> int:
        """Length of a VLAD vector."""
        return int(self.words.size)


def vlad(features: LocalFeatures, vocabulary: Vocabulary) -> NDArray[np.float32] | None:
    """The image as one vector of unit length, shape (K * D,); None where it has no features.

    Every feature's residual to its nearest word is summed per word, each sum made of unit length (intra-normalisation,
    Arandjelovic & Zisserman, CVPR 2013: a texture that repeats counts once), and signed square roots taken.
    """
    x, words = as_floats(features.descriptors), vocabulary.words
    if not len(x):
        return None
    if x.shape[1] != words.shape[1]:
        raise DataError(
            f"features of {x.shape[1]} numbers against words of {words.shape[1]}",
            where="vocabulary",
            remedy="extract the features that the vocabulary was learnt from (SIFT or ORB)",
        )
    word = np.argmin((words * words).sum(1) - 2.0 * (x @ words.T), axis=1)
    chosen = (word[:, None] == np.arange(len(words))).astype(np.float32)
    sums = chosen.T @ x - chosen.sum(0)[:, None] * words
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
    rooted = (np.sign(sums) * np.sqrt(np.abs(sums))).ravel()
    length = float(np.linalg.norm(rooted))
    return rooted / np.float32(length) if length > 0.0 else None


def as_floats(descriptors: NDArray[Any]) -> NDArray[np.float32]:
    """Local descriptors (N, D) as float32; those of bits (uint8) as 0 and 1, shape (N, 8 D)."""
    if descriptors.dtype == np.uint8:
        return np.unpackbits(descriptors, axis=1).astype(np.float32)
    return np.asarray(descriptors, dtype=np.float32)
