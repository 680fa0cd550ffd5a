import numpy as np
import pytest
from scipy.linalg import expm

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
        self.C = shapes @ np.diag(2.0 * DAMPING * np.sqrt(square)) @ shapes.T
        system = np.zeros((11, 11))
        system[:5, 5:10], system[5:10, :5], system[5:10, 5:10], system[9, 10] = np.eye(5), -self.K, -self.C, 1.0
        self.step = expm(system / RATE)[:10]

    def record(self, seconds: float, seed: int, snr_db: float = 30.0) -> tuple[np.ndarray, ...]:
        """Times (N,), force (N,), displacements and accelerations (N, 5), noise on all but the displacements."""
        random, samples = np.random.default_rng(seed), int(seconds * RATE)
        spectrum = np.fft.rfft(random.normal(size=samples))
        spectrum[np.fft.rfftfreq(samples, 1.0 / RATE) > 8.0] = 0.0
        force = np.fft.irfft(spectrum, samples)
        states = np.zeros((samples + 1, 10))
        for i in range(samples):
            states[i + 1] = self.step @ np.append(states[i], force[i])
        u, v = states[:-1, :5], states[:-1, 5:]
        a = -u @ self.K.T - v @ self.C.T
        a[:, 4] += force
        noisy = [x + random.normal(size=x.shape) * x.std(axis=0) * 10.0 ** (-snr_db / 20.0) for x in (force, a)]
        return np.arange(samples) / RATE, noisy[0], u, noisy[1]


@pytest.fixture(scope="session")
def chain() -> Chain:
    return Chain()
