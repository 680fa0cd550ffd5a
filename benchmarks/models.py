"""Does the evidence find the law that a record comes from: `make bench-models`.

Twenty records of chains of two masses, each law the truth in turn, at four sizes: from 0.3 kg that move by a
millimetre to 20 tonnes that move by a metre. The truth is simulated here, by scipy's DOP853 and none of the program's
own code, with sensors of 40 dB on both masses. Each record is one command of a user: a sweep over five laws, in which
all but the masses is unknown. A law is found where it is the most probable one, or within `OPEN` of one that it
contains or that contains it: at a centimetre a Van der Pol damper is a linear one.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

LAWS = ("linear", "duffing", "van_der_pol", "polynomial", "bouc_wen")
CONTAINS: dict[str, tuple[str, ...]] = {
    "linear": (), "duffing": ("linear",), "van_der_pol": ("linear",), "polynomial": ("linear", "duffing"),
    "bouc_wen": ("linear",),
}  # fmt: skip
# Mass, kg; frequency of one mass on its spring, Hz, over sqrt(2); elongation, m. A Van der Pol damper turns at 1 m.
SIZES = ((4.0, 2.0, 0.02), (2000.0, 1.2, 0.01), (0.3, 6.0, 1e-3), (60.0, 3.0, 5e-3))
WIDE = ((10.0, 0.2, 0.6), (500.0, 0.5, 0.4), (2e4, 0.15, 1.0), (2.0, 1.0, 0.5))
SAMPLES, PER_PERIOD, NOISE = 400, 20, 0.01  # 40 dB
OPEN = 3.0  # nats


def parameters(law: str, size: int, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Of both connections, by the program's names; and the masses."""
    mass, frequency, u = (WIDE if law == "van_der_pol" else SIZES)[size]
    k = 2.0 * mass * (2.0 * np.pi * frequency) ** 2 * random.uniform(0.8, 1.25, 2)
    m = mass * random.uniform(0.8, 1.25, 2)
    c = 0.04 * np.sqrt(k * m.mean()) * random.uniform(0.7, 1.4, 2)
    about = random.uniform(0.7, 1.4, (2, 2))
    if law == "duffing":
        return {"m": m, "c": c, "k": k, "kappa": 0.6 * k / u**2 * about[0]}
    if law == "van_der_pol":
        return {"m": m, "c": 1.5 * c, "k": k, "mu": 1.2 * c * about[0]}
    if law == "polynomial":
        return {"m": m, "c": c, "k": k, "k_2": 0.35 * k / u * about[0], "k_3": 0.6 * k / u**2 * about[1]}
    if law == "bouc_wen":
        bend = {"beta": 0.6 / u * about[0], "gamma": np.full(2, 0.3 / u)}
        return {"m": m, "c": c, "k": 0.4 * k, "A": 0.6 * k, **bend}
    return {"m": m, "c": c, "k": k}


def simulated(law: str, size: int) -> tuple[pd.DataFrame, np.ndarray]:
    """The record, and the masses, kg."""
    random = np.random.default_rng([size, LAWS.index(law)])
    p = parameters(law, size, random)
    _, frequency, u = (WIDE if law == "van_der_pol" else SIZES)[size]
    time = np.arange(SAMPLES) / (PER_PERIOD * frequency)
    rate = 4.0 * PER_PERIOD * frequency
    band = butter(4, [0.2 * frequency, 3.0 * frequency], btype="band", output="sos", fs=rate)
    noise = sosfiltfilt(band, random.standard_normal(4 * SAMPLES))
    size_of_force = 0.35 * u * float(p["k"].mean()) / noise.std()
    force = make_interp_spline(np.arange(4 * SAMPLES) / rate, size_of_force * noise, k=5)

    def slope(t: float, state: np.ndarray) -> np.ndarray:
        x, v, z = state[:2], state[2:4], state[4:]
        e, de = np.diff(x, prepend=0.0), np.diff(v, prepend=0.0)
        r = p["c"] * de + p["k"] * e + p.get("kappa", 0.0) * e**3 + p.get("mu", 0.0) * (e**2 - 1.0) * de
        r = r + p.get("k_2", 0.0) * e**2 + p.get("k_3", 0.0) * e**3
        hidden = np.empty(0)
        if len(z):
            r = r + z
            hidden = p["A"] * de - p["beta"] * np.abs(de) * z - p["gamma"] * de * np.abs(z)
        acting = np.array([0.0, float(force(t))])
        return np.concatenate([v, (acting - r + np.append(r[1:], 0.0)) / p["m"], hidden])

    found: Any = solve_ivp(
        slope, (0.0, time[-1]), np.zeros(6 if law == "bouc_wen" else 4), method="DOP853", t_eval=time, rtol=1e-9,
        atol=1e-13, max_step=0.5 / frequency,
    )  # fmt: skip
    motion = np.array([slope(t, state)[2:4] for t, state in zip(time, found.y.T, strict=True)])
    clean = {"acceleration.1": motion[:, 0], "acceleration.2": motion[:, 1], "force.2": force(time)}
    noisy = {
        name: values + NOISE * np.sqrt(np.mean(values**2)) * random.standard_normal(SAMPLES)
        for name, values in clean.items()
    }
    return pd.DataFrame({"t": time, **noisy}), p["m"]


def models(law: str, size: int, folder: Path) -> pd.DataFrame:
    """``models.csv`` of the command, by law."""
    record, m = simulated(law, size)
    record.to_csv(folder / "rig.csv", index=False)
    last = float(record["t"].iloc[-1])
    command = [
        sys.executable, "-m", "pinn_cli.main", "--multirun", f"system={','.join(LAWS)}", "scheme=state_parameter",
        "scheme.unknown=missing", "system.ndof=2", f"system.m=[{m[0]:.6g},{m[1]:.6g}]", "data=csv", "data.path=rig.csv",
        "data.force={2: force.2}", "data.acceleration={1: acceleration.1, 2: acceleration.2}",
        f"data.validation={{start: {0.75 * last:.6g}, stop: {last:.9g}}}", "hydra.sweep.dir=sweep",
    ]  # fmt: skip
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return pd.read_csv(folder / "sweep" / "models.csv").set_index("system")


def main() -> None:
    """Print a row for each record as it is done: how far every law lies behind the most probable one, nats."""
    right = 0
    for size in range(len(SIZES)):
        for law in LAWS:
            with TemporaryDirectory() as folder:
                table = models(law, size, Path(folder))
            behind = -table["log_bayes_factor"]
            best = str(behind.idxmin())
            nested = best in CONTAINS[law] or law in CONTAINS[best]
            is_right = best == law or (nested and bool(behind[law] < OPEN))
            right += is_right
            told = "  ".join(f"{name} {behind.get(name, np.nan):.1f}" for name in LAWS)
            error = table["validation_nmse_percent"].get(law, np.nan)
            print(f"{law:12} size {size}  {'found' if is_right else 'MISSED'}  {told}  NMSE {error:.3g} %", flush=True)
    print(f"{right} of {len(SIZES) * len(LAWS)}")


if __name__ == "__main__":
    main()
