"""VLAD: what the features of an image are beside the words of a vocabulary (Jegou et al., CVPR 2010)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import MiniBatchKMeans
from sklearn.decomposition import PCA

from uwgraph.errors import DataError
from uwgraph.places.local import LocalFeatures

MAX_SAMPLES: Final = 200_000
"""Features that the words are learnt from, at most."""


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """Visual words: centres of clusters of local descriptors, which are reduced by a PCA before.

    It is here that a descriptor is made short: a dive has a hundred thousand features but only some hundred images, and
    a PCA of so few images loses every place that was not among them.
    """

    mean: NDArray[np.float32]
    """Of the local descriptors, shape (B,); B is 128 for RootSIFT and 256 for the bits of ORB."""
    axes: NDArray[np.float32]
    """Principal axes, shape (D, B)."""
    words: NDArray[np.float32]
    """Shape (K, D)."""

    @classmethod
    def learn(
        cls, features: Sequence[LocalFeatures], words: int = 32, components: int = 64, random_state: int = 0
    ) -> Vocabulary:
        """The vocabulary of the features of many images: PCA, then k-means.

        Raises
        ------
        DataError
            When there are too few features for so many words or components.
        """
        samples = np.concatenate([as_floats(f.descriptors) for f in features]) if features else np.zeros((0, 1))
        if len(samples) < 2 * max(words, components):
            raise DataError(
                f"{len(samples)} features are too few for {words} words of {components} numbers",
                where="vocabulary",
                remedy="give more or sharper images, or fewer words",
            )
        if len(samples) > MAX_SAMPLES:
            samples = np.random.default_rng(random_state).choice(samples, MAX_SAMPLES, replace=False)
        pca = PCA(min(components, samples.shape[1]), svd_solver="covariance_eigh").fit(samples)
        reduced = pca.transform(samples).astype(np.float32)
        means = MiniBatchKMeans(words, batch_size=4096, n_init=3, random_state=random_state).fit(reduced)
        arrays = (pca.mean_, pca.components_, means.cluster_centers_)
        return cls(*(np.asarray(array, dtype=np.float32) for array in arrays))

    @property
    def size(self) -> int:
        """Length of a VLAD vector."""
        return int(self.words.size)

    def reduce(self, features: LocalFeatures) -> NDArray[np.float32]:
        """Local descriptors along the axes, shape (N, D); raises :class:`DataError` for features of another kind."""
        x = as_floats(features.descriptors)
        if x.shape[1] != len(self.mean):
            raise DataError(
                f"features of {x.shape[1]} numbers for a vocabulary of {len(self.mean)}",
                where="vocabulary",
                remedy="extract the features that the vocabulary was learnt from (SIFT or ORB)",
            )
        return np.asarray((x - self.mean) @ self.axes.T, dtype=np.float32)


def vlad(features: LocalFeatures, vocabulary: Vocabulary) -> NDArray[np.float32] | None:
    """The image as one vector of unit length, shape (K * D,); None where it has no features.

    Every feature's residual to its nearest word is summed per word, each sum made of unit length (intra-normalisation,
    Arandjelovic & Zisserman, CVPR 2013: a texture that repeats counts once), and signed square roots taken.
    """
    x, words = vocabulary.reduce(features), vocabulary.words
    if not len(x):
        return None
    word = np.argmin((words * words).sum(1) - 2.0 * (x @ words.T), axis=1)
    chosen = (word[:, None] == np.arange(len(words))).astype(np.float32)
    sums = chosen.T @ x - chosen.sum(0)[:, None] * words
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
    rooted = (np.sign(sums) * np.sqrt(np.abs(sums))).ravel()
    length = float(np.linalg.norm(rooted))
    return rooted / np.float32(length) if length > 0.0 else None


def as_floats(descriptors: NDArray[Any]) -> NDArray[np.float32]:
    """Local descriptors (N, B) as float32; those of bits (uint8) as 0 and 1, shape (N, 8 B)."""
    if descriptors.dtype == np.uint8:
        return np.unpackbits(descriptors, axis=1).astype(np.float32)
    return np.asarray(descriptors, dtype=np.float32)
