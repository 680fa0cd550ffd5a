"""Response, parameters and their uncertainty of structural chains, by physics-informed neural networks."""

import time

# When the process reached this package, by `time.perf_counter`: Python has run for some 0.05 s by then.
LOADED = time.perf_counter()
