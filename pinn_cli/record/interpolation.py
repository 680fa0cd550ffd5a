"""What acts between the samples where these are joined by straight lines: a first-order hold.

Records of earthquakes are kept at 50 or 100 values a second, and programs that shake a structure join them by straight
lines. A line's corners have content at all frequencies. Sampled again, what lies above the Nyquist frequency is folded
below it: the samples hold more than what moves the structure, by a tenth at a third of the Nyquist frequency.
"""

from __future__ import annotations

import numpy as np

from pinn_cli.record.record import INTERSAMPLE

FIRST_ORDER_HOLD = "first_order_hold"
BETWEEN_SAMPLES = (*INTERSAMPLE, FIRST_ORDER_HOLD)
# Samples per line that are looked for, and the blocks in which it is: so many lines each, the louder half of them.
LONGEST, LINES_PER_BLOCK, FEWEST_BLOCKS = 12, 8, 6
# Share of these blocks in which the corners have this part of all curvature.
MOST_BLOCKS, AT_CORNERS = 0.9, 0.75


def held_by_lines(values: np.ndarray) -> np.ndarray:
    """(N,), what straight lines between samples (N,) hold below the Nyquist frequency, at the samples.

    A line's spectrum is that of its samples times sinc^2 (f step), whatever longer lines these lie on. Beyond its ends
    the record goes on as its own odd reflection, as in :func:`pinn_cli.record.decimation.decimate`.
    """
    before, after = 2.0 * values[0] - values[:0:-1], 2.0 * values[-1] - values[-2::-1]
    longer = np.concatenate((before, values, after))
    filtered = np.fft.irfft(np.fft.rfft(longer) * np.sinc(np.fft.rfftfreq(len(longer))) ** 2, len(longer))
    return np.asarray(filtered[len(before) : len(before) + len(values)])


def samples_per_line(values: np.ndarray) -> int:
    """Of how many samples the straight lines are on which samples (N,) lie; 1 where they lie on none.

    Their second difference is then noise but for every so manieth sample, a corner.
    """
    curvature = np.square(np.diff(values, 2))
    for length in range(2, LONGEST + 1):
        size = length * LINES_PER_BLOCK
        blocks = curvature[: len(curvature) // size * size].reshape(-1, LINES_PER_BLOCK, length).sum(axis=1)
        blocks = blocks[np.argsort(blocks.sum(axis=1))[len(blocks) // 2 :]]
        if len(blocks) < FEWEST_BLOCKS or not blocks.any():
            break
        corners = blocks[:, np.argmax(blocks.sum(axis=0))]
        if np.mean(corners >= AT_CORNERS * blocks.sum(axis=1)) >= MOST_BLOCKS:
            return length
    return 1
