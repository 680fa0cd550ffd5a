import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

RATE = 50.0
DAMPING = 0.02


class Chain:
    """Five masses of 1 kg, 2 % damping in every mode; a force on the last, constant from sample to sample."""

    def __init__(self) -> None:
        n = 5
        k = (2.0 * np.pi * 0.890 / (2.0 * np.sin(np.pi / 22.0))) ** 2
        self.K = k * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
        self.K[-1, -1] = k
        square, shapes = np.linalg.eigh(self.K)
        C = shapes @ np.diag(2.0 * DAMPING * np.sqrt(square)) @ shapes.T
        flow = np.block([[np.zeros((n, n)), np.eye(n)], [-self.K, -C]])
        push = np.eye(2 * n)[:, -1:]
        # Displacements and accelerations of states and of the force.
        self.system = cont2discrete((flow, push, np.vstack((np.eye(n, 2 * n), flow[n:])), push), 1.0 / RATE)

    def record(self, seconds: float, seed: int, snr_db: float = 30.0) -> tuple[np.ndarray, ...]:
        """Times (N,), force (N,), displacements and accelerations (N, 5), noise on all but the displacements."""
        random, samples = np.random.default_rng(seed), int(seconds * RATE)
        spectrum = np.fft.rfft(random.normal(size=samples))
        spectrum[np.fft.rfftfreq(samples, 1.0 / RATE) > 8.0] = 0.0
        force = np.fft.irfft(spectrum, samples)
        u, a = np.hsplit(dlsim(self.system, force)[1], 2)
        noisy = [x + random.normal(size=x.shape) * x.std(axis=0) * 10.0 ** (-snr_db / 20.0) for x in (force, a)]
        return np.arange(samples) / RATE, noisy[0], u, noisy[1]


@pytest.fixture(scope="session")
def chain() -> Chain:
    return Chain()
