"""The central 90 % interval, which every table of parameters gives."""

from __future__ import annotations

# Its ends as probabilities.
CENTRAL_90 = (0.05, 0.95)
# Half its width for a normal distribution, in standard deviations.
HALF_WIDTH_90 = 1.6448536269514722
