"""Files damaged at random, reproducibly."""

import numpy as np
import numpy.typing as npt


def mutated(raw: npt.NDArray[np.uint8], seed: int) -> bytes:
    """A damaged copy: bytes flipped, words set to extremes, the end cut off, a part repeated, moved or zeroed."""
    rng = np.random.default_rng(seed)
    copy = raw.copy()
    # Headers are where a parser can be led astray; most damage goes there.
    head = min(len(raw), 4096)
    where = int(rng.integers(0, head if rng.random() < 0.7 else len(raw)))
    match int(rng.integers(0, 6)):
        case 0:
            flips = rng.integers(0, head, int(rng.integers(1, 8)))
            copy[flips] = rng.integers(0, 256, len(flips))
        case 1:
            copy[where : where + 8] = rng.choice([0, 1, 127, 255], len(copy[where : where + 8]))
        case 2:
            copy = copy[:where]
        case 3:
            copy = np.concatenate([copy[:where], copy[where // 2 :]])
        case 4:
            copy[where : where + int(rng.integers(8, 512))] = 0
        case 5:
            bits = rng.integers(0, len(copy), int(rng.integers(1, 20)))
            copy[bits] ^= (1 << rng.integers(0, 8, len(bits))).astype(np.uint8)
    return copy.tobytes()
