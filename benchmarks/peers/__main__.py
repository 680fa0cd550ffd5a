"""Other people's packages on the records that this program solves: ``make bench-peers``.

Two records. The chain is the paper's: six masses, cubic springs, two accelerometers and a load cell, 50 dB, the force
held between samples. Its parameters are known to all but this program, which takes them to be known to 7.5 %. The frame
has five floors in the wind, three accelerometers, and lasts 300 s. This program is given its masses, and stiffnesses
and dampers that are 5 to 10 % off; `pinn-run modes` is given the record alone. Scripts of the peers see a record and no
truth; what they set was tuned by hand, with the truth.

Each script runs in a process of its own, in an environment of the peers' (``build/peers/.venv``). The table has
accuracy, processor seconds of the whole process, lines that a user writes (no comments, no blanks), and settings that
were tuned. Rows go into ``outputs/peers/results.csv``; ``python -m benchmarks.peers jinns`` makes one of them anew.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PLACE, ENVIRONMENT = ROOT / "outputs" / "peers", ROOT / "build" / "peers" / ".venv"
QUANTITIES = ("displacement", "velocity", "acceleration")
CHAIN = ["experiment=paper/sr_6dof_snr50"]
FRAME = [
    "experiment=examples/ambient_vibration", "model_error=perturbed", "scheme.parameter_uncertainty=0.1",
    "simulation.duration=300", "simulation.samples=15001",
]  # fmt: skip
ONE_THREAD = {"OMP_NUM_THREADS": "1", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"}


@dataclass(frozen=True)
class Peer:
    """A row of the table: who, on which record, by which script; None is this program."""

    name: str
    record: str
    script: str | None = None


PEERS = (
    Peer("pinn-run", "chain"),
    Peer("jinns", "chain", "jinns_chain.py"),
    Peer("DeepXDE", "chain", "deepxde_chain.py"),
    Peer("dynamax", "chain", "dynamax_smoother.py"),
    Peer("pinn-run", "frame"),
    Peer("KOMA", "frame", "koma_modes.py"),
    Peer("pinn-run modes", "frame"),
    Peer("pyOMA2", "frame", "pyoma2_modes.py"),
)


def environment() -> Path:
    """Python of the peers' environment, which is made where it is missing."""
    python = ENVIRONMENT / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", ENVIRONMENT], check=True)
        constrained = os.environ | {"PIP_CONSTRAINT": str(ROOT / "constraints.txt")}
        subprocess.run([python, "-m", "pip", "install", "--quiet", "torch"], check=True, env=constrained)
        wanted = ["-r", str(HERE / "requirements.txt")]
        subprocess.run([python, "-m", "pip", "install", "--quiet", *wanted], check=True)
    return python


def processor_seconds(command: list[str | Path]) -> float:
    """User and system seconds of a command, on one thread.

    Raises:
        subprocess.CalledProcessError: It failed.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, env=os.environ | ONE_THREAD, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def own_run(record: str) -> tuple[Path, float]:
    """This program's run of a record and its seconds; the record comes from it, for the others."""
    directory = PLACE / record
    overrides = CHAIN if record == "chain" else FRAME
    code = "from pinn_cli.main import main; main()"
    settings = ["figures=false", "resume=never", f"hydra.run.dir={directory}"]
    return directory, processor_seconds([sys.executable, "-c", code, *overrides, *settings])


def own_modes(record: Path) -> tuple[Path, float]:
    """Modes that this program finds in a record without a model, a table, and its seconds."""
    directory = PLACE / "modes"
    command = [sys.executable, "-m", "pinn_cli", "modes", record, "figures=false", f"hydra.run.dir={directory}"]
    return directory / "modes.csv", processor_seconds(command)


def write_record(directory: Path, file: Path) -> None:
    """What the sensors of a run's record read: t (s), forces (N), accelerations (m/s^2)."""
    with xr.open_dataset(directory / "response.nc", engine="h5netcdf") as response:
        samples = response.sizes["time"]
        # The file's times are rounded.
        columns = {"t": np.linspace(0.0, float(response["time"][-1]), samples)}
        for quantity, prefix in (("force", "f"), ("acceleration", "a")):
            seen = response[f"{quantity}_observed"].dropna("dof", how="all")
            columns |= {f"{prefix}{dof}": seen.sel(dof=dof).to_numpy() for dof in seen["dof"].to_numpy()}
    pd.DataFrame(columns).to_csv(file, index=False)


def fitness(directory: Path, estimate: dict[str, np.ndarray] | None) -> str:
    """Range fitness of displacement, velocity and acceleration, mean over all masses, in per cent."""
    scores = []
    with xr.open_dataset(directory / "response.nc", engine="h5netcdf") as response:
        for quantity in QUANTITIES:
            truth = response[f"{quantity}_true"].to_numpy()
            found = response[quantity].to_numpy() if estimate is None else estimate[quantity]
            rms = np.sqrt(np.mean((found - truth) ** 2, axis=0))
            scores.append(float(np.mean(100 * (1 - rms / np.ptp(truth, axis=0)))))
    return " ".join(f"{score:.2f}" for score in scores)


def modal_errors(directory: Path, modes: pd.DataFrame | None) -> str:
    """Root mean square errors of all frequencies and of all damping ratios, in per cent."""
    own = pd.read_csv(directory / "modes.csv")
    found = own if modes is None else modes
    errors = [
        100 * float(np.sqrt(np.mean((found[name].to_numpy() / own[f"true_{name}"].to_numpy() - 1) ** 2)))
        for name in ("frequency", "damping_ratio")
    ]
    return "frequency {:.2f}, damping {:.1f}".format(*errors)


def lines_written(script: Path) -> int:
    """Lines of a script that are code."""
    text = script.read_text(encoding="utf-8")
    strings = {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = enumerate(text.splitlines(), 1)
    return sum(bool(line.strip()) and not line.strip().startswith("#") and i not in strings for i, line in lines)


def settings_tuned(script: Path) -> int:
    """Names that a script sets in its paragraph of tuned settings."""
    (paragraph,) = re.findall(r"^# Tuned .*\n((?:\S.*\n)+)", script.read_text(encoding="utf-8"), re.MULTILINE)
    return sum(len(re.findall(r"[A-Z_]+", line.partition("=")[0])) for line in paragraph.splitlines())


def measured(peer: Peer) -> dict[str, object]:
    """The row of one peer, as the table has it."""
    directory, record, found, lines, tuned = PLACE / peer.record, PLACE / f"{peer.record}.csv", None, 1, 0
    if peer.script is not None:
        script = HERE / peer.script
        found = PLACE / f"{script.stem}{'.npz' if peer.record == 'chain' else '.csv'}"
        seconds = processor_seconds([environment(), script, record, found])
        lines, tuned = lines_written(script), settings_tuned(script)
    elif peer.name.endswith(" modes"):
        found, seconds = own_modes(record)
    else:
        directory, seconds = own_run(peer.record)
        write_record(directory, record)
    if peer.record == "chain":
        accuracy = fitness(directory, None if found is None else dict(np.load(found)))
    else:
        accuracy = modal_errors(directory, None if found is None else pd.read_csv(found))
    return {
        "record": peer.record, "program": peer.name, "accuracy": accuracy, "seconds": round(seconds, 1), "lines": lines,
        "tuned": tuned,
    }  # fmt: skip


def main() -> None:
    """Measure the peers that are named, or all, and print the table of all that have been."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="pinn-run, jinns, DeepXDE, dynamax, KOMA, pyOMA2, ...; default: all")
    names = [name.lower() for name in parser.parse_args().names]
    PLACE.mkdir(parents=True, exist_ok=True)
    results = PLACE / "results.csv"
    rows = pd.read_csv(results).to_dict("records") if results.is_file() else []
    for peer in PEERS:
        if not names or peer.name.lower() in names:
            new = measured(peer)
            rows = [old for old in rows if (old["record"], old["program"]) != (peer.record, peer.name)] + [new]
            pd.DataFrame(rows).to_csv(results, index=False)
    print(pd.DataFrame(rows).to_string(index=False))


if __name__ == "__main__":
    main()
