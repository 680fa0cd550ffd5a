"""What a finished run is worth: its estimates, bands and verdict against the truth."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from scipy.special import ndtri

from benchmarks.trust.case import Case, Truth

# Wrong is an estimate that is both more standard deviations and more per cent off than these.
STIFFNESS = ("k_", "factor_")
WRONG_STIFFNESS = (5.0, 2.0)
WRONG_OTHER = (4.0, 10.0)
# ... or a 95 % band that holds less than this share of the displacement of any DOF.
LEAST_INSIDE = 0.7
LEVELS = (50, 90, 95)
QUANTITIES = {"displacement": "u", "velocity": "v", "acceleration": "a"}

SOUND, FALSE_ALARM, CAUGHT, WRONG_AND_SOUND, ERROR = (
    "right and sound",
    "right, not sound",
    "wrong, not sound",
    "wrong and sound",
    "error",
)
OUTCOMES = (SOUND, FALSE_ALARM, CAUGHT, WRONG_AND_SOUND, ERROR)

Row = dict[str, object]


@dataclass(frozen=True)
class Scored:
    """The row of a case, and a row for each of its parameters."""

    row: Row
    parameters: pd.DataFrame


def scored(case: Case, directory: Path, reason: str) -> Scored:
    """Compare what a run left behind with the truth.

    Args:
        case: What was estimated.
        directory: Of the run.
        reason: Why it failed, where it did.
    """
    row: Row = {"case": case.name, "family": case.family, "seed": case.seed, "fault": case.fault}
    ended = {"about": case.about, "reasons": reason}
    nothing = pd.DataFrame(columns=["parameter", "true", "estimate", "std", "lower_90", "upper_90"])
    if not (directory / "run.json").is_file() or not (directory / "response.nc").is_file():
        # A fault that is refused in words that name it is told as well as one that a verdict names.
        return Scored(row | {"outcome": ERROR, "named": _named(case.truth, [reason])} | ended, nothing)
    run = json.loads((directory / "run.json").read_text(encoding="utf-8"))
    table = _parameters(case.truth, directory)
    bands, wrong_band = _bands(case.truth, directory / "response.nc")
    z = np.abs(_z(table))
    off = 100.0 * np.abs(table["estimate"] / table["true"] - 1.0).to_numpy()
    stiff = np.array([str(name).startswith(STIFFNESS) for name in table["parameter"]], bool)
    limits = np.where(stiff, WRONG_STIFFNESS[0], WRONG_OTHER[0]), np.where(stiff, WRONG_STIFFNESS[1], WRONG_OTHER[1])
    # A missing or unusable number is no estimate.
    wrong = bool((~((z <= limits[0]) | (off <= limits[1]))).any()) or wrong_band
    sound = run.get("verdict", "sound") == "sound"  # a prediction passes none, and is taken as it is
    outcome = {(False, True): SOUND, (False, False): FALSE_ALARM, (True, False): CAUGHT, (True, True): WRONG_AND_SOUND}
    seconds = run.get("seconds", {})
    row |= {
        "outcome": outcome[wrong, sound],
        "verdict": run.get("verdict"),
        "named": _named(case.truth, run.get("reasons", [])),
        "worst_parameter": table["parameter"][int(np.argmax(np.nan_to_num(z)))] if len(z) else "",
        "worst_z": float(np.nan_to_num(z).max(initial=0.0)),
        "worst_percent": float(np.nan_to_num(off).max(initial=0.0)),
        "seconds": seconds.get("processor"),
        "elapsed": seconds.get("total"),
        "mebibytes": run.get("peak_memory_mib", {}).get("process"),
    }
    ended["reasons"] = " | ".join(run.get("reasons", []))
    return Scored(row | bands | ended, table)


def _named(truth: Truth, reasons: list[str]) -> int | None:
    """Whether a reason names the fault, 1 or 0; None where there is none."""
    if not truth.names_it:
        return None
    return int(any(re.search(truth.names_it, reason, flags=re.IGNORECASE) for reason in reasons))


def _parameters(truth: Truth, directory: Path) -> pd.DataFrame:
    """True value, estimate and interval of every parameter that is compared; NaN where the run has none."""
    columns = ["parameter", "estimate", "std", "lower_90", "upper_90"]
    found = pd.DataFrame(columns=columns)
    if (directory / "parameters.csv").is_file():
        found = pd.read_csv(directory / "parameters.csv")
        found = found[found["estimator"] == "pinn"][columns]
    found = found.set_index("parameter").reindex(list(truth.parameters)).reset_index(names="parameter")
    return found.assign(true=list(truth.parameters.values())).astype(dict.fromkeys(["true", *columns[1:]], float))


def _z(table: pd.DataFrame) -> np.ndarray:
    """Errors in standard deviations, signed, (parameters,)."""
    error = table["estimate"].to_numpy() - table["true"].to_numpy()
    std = table["std"].to_numpy()
    return np.where(error == 0.0, 0.0, error / np.maximum(std, 1e-300))


def inside(table: pd.DataFrame) -> dict[int, np.ndarray]:
    """Whether the intervals of each level hold the true values: those of 90 % as the run gives them."""
    z = np.abs(_z(table))
    found = {level: z <= ndtri(0.5 + level / 200.0) for level in LEVELS}
    found[90] = ((table["lower_90"] <= table["true"]) & (table["true"] <= table["upper_90"])).to_numpy()
    return found


def _bands(truth: Truth, path: Path) -> tuple[Row, bool]:
    """Shares of unsensed histories inside their bands and rms of z; whether a band of u is wrong anywhere."""
    if not len(truth.displacement):
        return {}, False
    row: Row = {}
    wrong = False
    with xr.open_dataset(path) as response:
        for quantity, letter in QUANTITIES.items():
            true = getattr(truth, quantity)
            estimate, std = response[quantity].to_numpy(), response[f"{quantity}_std"].to_numpy()
            if estimate.shape != true.shape:
                raise ValueError(f"{path}: {quantity} is {estimate.shape}, and the truth is {true.shape}")
            # What is known exactly, such as a DOF at rest, differs by rounding alone.
            z = np.abs(estimate - true) / np.maximum(std, 1e-9 * max(float(np.abs(true).max()), 1e-300))
            if letter == "u":
                wrong = bool((np.mean(z <= ndtri(0.975), axis=0) < LEAST_INSIDE).any())
            hidden = np.setdiff1d(np.arange(true.shape[1]), truth.sensed)
            if len(hidden):
                row |= {
                    f"{letter}_{level}": float(np.mean(z[:, hidden] <= ndtri(0.5 + level / 200.0))) for level in LEVELS
                }
                row[f"{letter}_rms"] = float(np.sqrt(np.mean(np.minimum(z[:, hidden], 1e3) ** 2)))
    return row, wrong
