"""Streams of chance that do not disturb each other: one for each purpose."""

from zlib import crc32

import numpy as np


def stream(seed: int, purpose: str) -> np.random.Generator:
    """The stream of one purpose in the log of this seed."""
    return np.random.default_rng([seed, crc32(purpose.encode())])
