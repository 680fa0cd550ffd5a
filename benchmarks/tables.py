"""Tables of README.md and docs/ from runs of `pinn-run` as a user types it: ``make tables ARGS="mlp smoother"``.

Each is written into its page (`benchmarks.written`). Seconds are processor seconds of one thread.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pandas as pd
import xarray as xr
from scipy.linalg import eigh

from benchmarks.__main__ import counted
from benchmarks.gallery import DOCS, performed
from benchmarks.written import ROOT, markdown, write
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.report.fitness import published

SPARSE = (
    "sr_6dof_snr50", "sr_6dof_snr20", "sr_6dof_snr10", "sr_20dof_snr50", "sr_6dof_linear", "sr_6dof_perturbed",
)  # fmt: skip
STATE_PARAMETER = tuple(f"sp_5dof_{case}" for case in ("snr50", "snr20", "snr10", "van_der_pol", "linear", "perturbed"))
FIXED, SMOOTHED, MLP = "scheme.parameter_uncertainty=0", "baseline=kalman_smoother", "network=mlp"
QUANTITIES = (*RESPONSE_QUANTITIES, "force")
SCORES = {"range": "range_fitness_percent", "printed": "fitness_percent"}


@dataclass(frozen=True)
class Run:
    """A finished run: its directory, and the seconds that it took."""

    directory: Path
    seconds: dict[str, float]

    def fitness(self, formula: str = "range", estimator: str = "pinn") -> np.ndarray:
        """Of u, u', u'' over all DOFs and of the force where it acts, %, (4,)."""
        table = pd.read_csv(self.directory / "fitness.csv").query("estimator == @estimator and group == 'all'")
        found: np.ndarray = table.set_index("quantity")[SCORES[formula]].loc[list(QUANTITIES)].to_numpy()
        return found

    def cover(self) -> np.ndarray:
        """Share of the truth in the 95 % bands, %, (4,); of the force, at DOF 1."""
        with xr.open_dataset(self.directory / "response.nc", engine="h5netcdf") as response:
            inside = [
                (np.abs(response[name] - response[f"{name}_true"]) <= 1.96 * response[f"{name}_std"])
                .isel(dof=slice(None) if name != "force" else [0])
                .to_numpy()
                for name in QUANTITIES
            ]
        return 100.0 * np.array([held.mean() for held in inside])


@cache
def run(*overrides: str) -> Run:
    """Of `pinn-run`, once for each set of overrides; without figures."""
    directory = Path(mkdtemp(prefix="tables-")) / "run"
    return Run(directory, counted([*overrides, "figures=false"], directory))


def texts(values: np.ndarray, form: str = "{:.2f}") -> str:
    """Numbers side by side; nothing for those that are unknown."""
    return " ".join(form.format(value) for value in values if np.isfinite(value))


def published_fitness(case: str) -> str:
    """Of u, u', u'' over all DOFs, and of the force where there is a load cell, %."""
    table = published("fitness").query("case == @case").set_index(["group", "quantity"])["fitness_percent"]
    loaded = [value for (_, quantity), value in table.items() if quantity == "force"]
    return texts(np.array([*table["all"].reindex(RESPONSE_QUANTITIES), *loaded[:1]]))


def first_run() -> str:
    """The table that the first command prints."""
    called = [sys.executable, "-m", "pinn_cli.main", "figures=false", f"hydra.run.dir={mkdtemp(prefix='tables-')}"]
    shown = subprocess.run(called, stdout=subprocess.PIPE, text=True, check=True).stdout
    found = re.search(r"^ +fitness, printed formula.*?^unobserved .*?$", shown, re.MULTILINE | re.DOTALL)
    assert found
    return f"```\n{found[0]}\n```"


def sparse_recovery() -> str:
    """The paper's six cases, parameters uncertain and fixed."""
    rows = []
    for case in SPARSE:
        ours, fixed = run(f"experiment=paper/{case}"), run(f"experiment=paper/{case}", FIXED)
        found = [part for of in (ours, fixed) for part in (texts(of.fitness()), f"{of.seconds['cpu_s']:.1f}")]
        rows.append([case, published_fitness(case), *found])
    assumed = "fixed parameters (the paper's assumption)"
    return markdown(
        pd.DataFrame(rows, columns=["case", "published", "uncertain parameters (default)", "s", assumed, "s"])
    )


def state_parameter() -> str:
    """The paper's six cases with unknown springs."""
    rows = []
    for case in STATE_PARAMETER:
        found, theirs = run(f"experiment=paper/{case}"), published("parameters").query("case == @case")
        ours = pd.read_csv(found.directory / "parameters.csv").set_index("parameter")["error_percent"]
        rows.append({
            "case": case, "published fitness": published_fitness(case), "ours": texts(found.fitness()),
            "errors of k_2, k_4, κ_2 or μ_2, κ_4 or μ_4: published": texts(theirs["error_percent"].to_numpy()),
            "errors, ours": texts(ours.loc[list(theirs["parameter"])].to_numpy()),
        })  # fmt: skip
    return markdown(pd.DataFrame(rows))


def unknown_parameters() -> str:
    """Errors and intervals of unknown springs over ten noise seeds, with right and wrong models."""
    cases: dict[str, tuple[str, ...]] = {}
    for law, case in (("Duffing", "snr50"), ("Van der Pol", "van_der_pol")):
        for snr in (50, 20, 10):
            cases[f"{law}, SNR {snr}"] = (f"experiment=paper/sp_5dof_{case}", f"noise.snr_db={snr}")
    for name in ("perturbed", "linear"):
        cases[f"{name} model"] = (f"experiment=paper/sp_5dof_{name}",)
        cases[f"{name} model, held fixed"] = (f"experiment=paper/sp_5dof_{name}", FIXED)
    rows = []
    for case, settings in cases.items():
        each = [
            pd.read_csv(run(*settings, "noise.seeds=null", f"seed={i}").directory / "parameters.csv") for i in range(10)
        ]
        found = pd.concat([table[table["prescribed"].isna()] for table in each])
        off = (100.0 * (found["estimate"] / found["true"] - 1.0)).abs().groupby(found["parameter"], sort=False).median()
        held = ((found["lower_90"] <= found["true"]) & (found["true"] <= found["upper_90"])).mean()
        cells = [f"{value:.2g}" for value in off] + [""] * (4 - len(off))
        rows.append([case, *cells, f"{100.0 * held:.1f} %"])
    columns = ["case", "k_2", "k_4", "κ_2 or μ_2", "κ_4 or μ_4", "intervals that hold the truth"]
    return markdown(pd.DataFrame(rows, columns=columns))


def modes_in_a_band() -> str:
    """Ten records of wings with modes inside and outside of the band, for each case."""
    six = (5.19, 6.61, 6.88, 7.32, 9.17, 10.9)
    columns = ["record", "frequency", "damping ratio", "modal mass", "as many modes", "sound"]
    rows = [
        _modes_of("six modes in 4 to 12 Hz, 3 sensors, 40 s", six, (4.0, 12.0), 3, 40.0),
        _modes_of("the same, 2 sensors, none at the driven point, 20 s", six, (4.0, 12.0), 2, 20.0, driven=False),
        _modes_of("one mode in 7 to 7.8 Hz, 1 sensor, 40 s", (6.6, 7.32, 9.2), (7.0, 7.8), 1, 40.0),
    ]
    return markdown(pd.DataFrame(rows, columns=columns))


def _modes_of(
    case: str, frequencies: tuple[float, ...], band: tuple[float, float], sensors: int, seconds: float,
    driven: bool = True,
) -> list[str]:  # fmt: skip
    """A row: median error (largest) and coverage of 90 % intervals of each quantity; runs of ten."""
    from vibrating_records import wing, wing_record, write_wing  # of tests/

    found: list[pd.DataFrame] = []
    sound = 0
    for seed in range(10):
        true = wing(seed, sensors, frequencies, driven)
        path = write_wing(wing_record(true, seed, seconds), Path(mkdtemp(prefix="tables-")) / "wing.csv")
        places = ", ".join(f"{i}: a{i}" if driven else f"p{i}: a{i}" for i in range(1, sensors + 1))
        force = "1: f" if driven else "engine: f"
        directory = run("data=csv", f"data.path={path}", "data.time=t", f"data.force={{{force}}}",
                        f"data.acceleration={{{places}}}", f"data.band=[{band[0]},{band[1]}]", "system=modal",
                        "scheme=state_parameter").directory  # fmt: skip
        sound += json.loads((directory / "run.json").read_text(encoding="utf-8"))["verdict"] == "sound"
        inside = (true.frequencies > band[0]) & (true.frequencies < band[1])
        modes = pd.read_csv(directory / "modes.csv")
        if len(modes) != inside.sum():
            continue
        parameters = pd.read_csv(directory / "parameters.csv")
        masses = parameters[parameters["parameter"].str.startswith("m_mode_")]
        # Where no sensor is at the driven point, a shape is one at the sensor that shows it best.
        residues = true.residues[0] if driven else np.abs(true.residues).max(axis=0)
        for of, name, prefix, exact in (
            (modes, "frequency", "", true.frequencies),
            (modes, "damping_ratio", "damping_ratio_", true.ratios),
            (masses, "estimate", "", 1.0 / residues),
        ):
            estimates = of[[name, f"{prefix}lower_90", f"{prefix}upper_90"]].set_axis(
                ["found", "lower", "upper"], axis=1
            )
            found.append(estimates.assign(quantity=name, true=exact[inside]))
    cells = []
    for _, of in pd.concat(found).groupby("quantity", sort=False):
        off = 100.0 * (of["found"] / of["true"] - 1.0).abs()
        held = 100.0 * ((of["lower"] <= of["true"]) & (of["true"] <= of["upper"])).mean()
        cells.append(f"{off.median():.2g} % ({off.max():.2g}), {held:.0f} %")
    return [case, *cells, f"{len(found) // 3} of 10", f"{sound} of 10"]


def mlp() -> str:
    """A perceptron on the paper's cases of sparse recovery."""
    rows = []
    for case, *more in (("sr_6dof_snr50",), *(("sr_6dof_snr50", f"seed={seed}") for seed in (1, 2)),
                        *((case,) for case in SPARSE[1:])):  # fmt: skip
        found = run(f"experiment=paper/{case}", MLP, *more)
        training = json.loads((found.directory / "run.json").read_text(encoding="utf-8"))["training"]
        rows.append({
            "case": ", ".join([case, *more]).replace("=", " "), "published": "" if more else published_fitness(case),
            "`network=mlp`": texts(found.fitness()), "steps": training["iterations"],
            "s": f"{found.seconds['estimate_cpu_s']:.1f}",
        })  # fmt: skip
    return markdown(pd.DataFrame(rows))


def smoother() -> str:
    """Network and Kalman smoother on the same records."""
    rows = []
    for settings in (*((f"experiment=paper/{case}",) for case in SPARSE), ("system.kappa=2000", "excitation.rms=5")):
        found = run(*settings, SMOOTHED)
        case = settings[0].partition("/")[2] or f"`{' '.join(settings)}`"
        rows.append([case, *(texts(found.fitness(estimator=name)) for name in ("pinn", "kalman_smoother"))])
    return markdown(pd.DataFrame(rows, columns=["case", "network", "smoother"]))


def coverage() -> str:
    """Ten records of the default chain for each case, force and noise drawn anew."""
    cases = {f"SNR {snr}": (f"noise.snr_db={snr}",) for snr in (50, 20, 10)}
    cases |= {f"{name} model, SNR 50": (f"model_error={name}",) for name in ("linear", "perturbed")}
    rows = []
    for case, settings in cases.items():
        seeds = [run(*settings, "simulation.hold=exact", f"seed={i}", f"excitation.seed={i}") for i in range(10)]
        fits = [np.mean([each.fitness(formula) for each in seeds], axis=0) for formula in SCORES]
        rows.append([case, texts(np.mean([each.cover() for each in seeds], axis=0), "{:.1f}"), *map(texts, fits)])
    columns = ["case", "cover u, u̇, ü, f", "range fitness u, u̇, ü, f", "printed formula"]
    return markdown(pd.DataFrame(rows, columns=columns))


def gradients() -> str:
    """Trainings by gradients of a small network."""
    network = ("experiment=paper/sr_6dof_snr50", MLP, "network.activation=sine", "network.depth=2", "network.width=30",
               "network.continuity=exact")  # fmt: skip
    trainings = (("adam", "", 8000), ("lbfgs", "", 3000), ("lbfgs", "equalised", 3000))
    rows = []
    for name, weights, iterations in trainings:
        chosen = [f"training.weights={weights}"] if weights else []
        found = run(*network, f"training={name}", f"training.iterations={iterations}", *chosen)
        seconds = f"{found.seconds['estimate_cpu_s']:.0f}"
        rows.append([name, weights or "fixed", iterations, seconds, texts(found.fitness()[:3], "{:.1f}")])
    return markdown(pd.DataFrame(rows, columns=["training", "weights", "iterations", "s", "u, u̇, ü"]))


def measured_record() -> str:
    """The modes that the page's last command finds, and those of the structure of docs/records/make_rig.py."""
    _, directory = performed(DOCS / "measured-record.md", Path(mkdtemp(prefix="tables-")))
    rows = np.eye(3) - np.eye(3, k=-1)
    squares, shapes = eigh(rows.T @ np.diag([40e3, 36e3, 44e3]) @ rows / 5.2)
    damping = np.diag(shapes.T @ (15.0 * rows.T @ rows / 5.2) @ shapes) / 2.0
    true = pd.DataFrame({"frequency": np.sqrt(squares) / (2 * np.pi), "damping": 100.0 * damping / np.sqrt(squares)})
    found = pd.read_csv(directory / "modes.csv")
    lines = [
        [int(of["mode"]), f"{of['frequency']:.4f}", f"{of['lower_90']:.4f} to {of['upper_90']:.4f}",
         f"{right['frequency']:.4f}", f"{100 * of['damping_ratio']:.3f}", f"{right['damping']:.3f}"]
        for (_, of), (_, right) in zip(found.iterrows(), true.iterrows(), strict=True)
    ]  # fmt: skip
    columns = ["mode", "frequency, Hz", "90 % interval", "frequency, true", "damping, %", "damping, true"]
    return markdown(pd.DataFrame(lines, columns=columns))


TABLES: dict[str, tuple[str, Callable[[], str]]] = {
    "first-run": ("README.md", first_run),
    "measured-record": ("docs/measured-record.md", measured_record),
    "sparse-recovery": ("docs/how-to/paper.md", sparse_recovery),
    "state-parameter": ("docs/how-to/paper.md", state_parameter),
    "smoother": ("docs/method.md", smoother),
    "mlp": ("docs/how-to/mlp.md", mlp),
    "modes-in-a-band": ("docs/how-to/modes-in-a-band.md", modes_in_a_band),
    "coverage": ("docs/method.md", coverage),
    "unknown-parameters": ("docs/method.md", unknown_parameters),
    "gradients": ("docs/method.md", gradients),
}


def main() -> None:
    """Make the tables that are named, or all, and write each into its page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tables", description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(TABLES)}; default: all")
    names = parser.parse_args().names
    for name, (page, made) in TABLES.items():
        if not names or name in names:
            write(ROOT / page, name, made(), f"make tables ARGS={name}")


if __name__ == "__main__":
    main()
