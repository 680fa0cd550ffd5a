"""Numbers on the command line that no run can use: one line with the setting and what is allowed, and no files."""

from pathlib import Path

import pytest
import torch
from calls import PinnRun

from pinn_cli.record.simulated import MOST_SIMULATED_STEPS, check_size
from pinn_cli.record.simulation import Simulation
from pinn_cli.runs.process import is_out_of_memory
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear

SIZE = "between 1e-30 and 1e+30 in size"
SETTINGS = {
    "noise.snr_db=-1e9": "noise.snr_db=-1000000000.0: must be a number of dB between -300 and 300, or null for no ",
    "noise.snr_db=1e9": "noise.snr_db=1000000000.0: must be a number of dB between -300 and 300, or null for no ",
    "noise.repeats=1000000000": "noise.repeats=1000000000: must be at most ",
    "simulation.duration=1e300": f"simulation.duration=1e+300: must be a finite number > 0, {SIZE}",
    "simulation.duration=1e-300": f"simulation.duration=1e-300: must be a finite number > 0, {SIZE}",
    "simulation.samples=3": "simulation.samples=3: must be a whole number >= 16",
    "simulation.samples=1000000000": "simulation.samples=1000000000: must be at most ",
    f"simulation.samples=1{'0' * 400}": f"simulation.samples=1{'0' * 400}: must be a whole number <= {2**63 - 1}",
    "system.ndof=1000000000": "system.ndof=1000000000: must be a whole number <= 2000",
    "system.ndof=2001": "system.ndof=2001: must be a whole number <= 2000",
    "system.k=1e300": f"system.k=1e+300: must be 0 or {SIZE}",
    f"system.k=1{'0' * 400}": f"system.k=1{'0' * 400}: must be a finite number or a list of 6 finite numbers",
    "system.k=1e12": "system.k=1000000000000.0: must be small enough for 10 kg not to have a natural frequency above ",
    "system.c=1e12": "system.c=1000000000000.0: must be small enough for 10 kg not to have a decay above ",
    "system.m=1e-12": "system.c=1.0: must be small enough for 1e-12 kg not to have a decay above ",
    "excitation.rms=1e300": f"excitation.rms=1e+300: must be a finite number > 0, {SIZE}",
    "excitation.rms=1e-300": f"excitation.rms=1e-300: must be a finite number > 0, {SIZE}",
    "excitation.band=[1e-320,1]": "excitation.band=[1e-320, 1]: must be [low, high] in Hz with 0 <= low < high",
    "scheme.parameter_uncertainty=1e300": "scheme.parameter_uncertainty=1e+300: must be a number between 0 and 1000",
    "network.intervals=1000000000000": "overrides=network.intervals=1000000000000: must be such that the run fits into",
    "threads=1000000000": "threads=1000000000: must be a whole number <= 1024",
    "seed=4294967296": "seed=4294967296: must be a whole number <= 4294967295",
}


@pytest.mark.parametrize(("override", "told"), SETTINGS.items())
def test_a_number_that_no_run_can_use(pinn_run: PinnRun, tmp_path: Path, override: str, told: str) -> None:
    pinn_run(override).refused(f"pinn-run: {told}")
    assert list(tmp_path.iterdir()) == []


def structure(ndof: int = 1, **parameters: float):
    return build_chain(ndof, Linear(), **{"m": 1.0, "c": 0.0, "k": 1.0, **parameters})


def test_a_chain_is_as_stiff_as_the_steps_allow() -> None:
    # Gershgorin's bound is sqrt(2 k / m) for one mass, and a step takes so much of its period over 2 pi.
    simulation = Simulation(duration=100.0, samples=1001)
    stiffest = (simulation.step_times_rate * MOST_SIMULATED_STEPS / 100.0) ** 2 / 2.0
    check_size(simulation, structure(k=0.99 * stiffest))
    with pytest.raises(InputError, match=r"^system\.k=.* 318 Hz"):
        check_size(simulation, structure(k=1.01 * stiffest))
    with pytest.raises(InputError, match=r"^simulation\.substeps=2001: must be at most 2000$"):
        check_size(Simulation(duration=100.0, samples=1001, substeps=2001), structure())


def test_memory_bounds_samples_dofs_and_repeats(monkeypatch) -> None:
    monkeypatch.setattr("pinn_cli.record.simulated.of_this_machine", lambda: 40_000_000)
    check_size(Simulation(duration=100.0, samples=1000), structure(100), repeats=12)
    with pytest.raises(InputError, match=r"^simulation\.samples=1001: must be at most 1000 with system.ndof=100; "):
        check_size(Simulation(duration=100.0, samples=1001), structure(100))
    with pytest.raises(InputError, match=r"^noise\.repeats=13: must be at most 12 with this record"):
        check_size(Simulation(duration=100.0, samples=1000), structure(100), repeats=13)
    monkeypatch.setattr("pinn_cli.record.simulated.of_this_machine", lambda: 4_000_000)
    with pytest.raises(InputError, match=r"^system\.ndof=1000: must be at most 10; "):
        check_size(Simulation(duration=100.0, samples=1000), structure(1000))


def test_memory_of_the_normal_equations_is_counted_before_they_are_made(pinn_run: PinnRun, tmp_path: Path) -> None:
    pinn_run("system.ndof=2000", "simulation.samples=1024", "simulation.duration=30", "excitation.band=[1,2]").refused(
        "pinn-run: system.ndof=2000: must be such that a run fits into the memory of this",
        " features x 2000 DOFs in a band of ",
    )
    assert list(tmp_path.iterdir()) == []


def test_what_libraries_say_when_memory_runs_out() -> None:
    with pytest.raises(RuntimeError) as raised:
        torch.empty(2**55)
    assert is_out_of_memory(raised.value)
    assert is_out_of_memory(MemoryError())
    assert not is_out_of_memory(RuntimeError("shapes do not fit"))
