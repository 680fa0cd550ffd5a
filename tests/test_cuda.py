"""What runs on a CUDA device finds what the processor finds; left out where there is none."""

import numpy as np
import pytest
import torch
from calls import SMALL, PinnRun
from small_problems import QUANTITIES, accelerations, measured, relative_error, small_chain

from pinn_cli.network.mlp import Mlp
from pinn_cli.network.network import NetworkDesign
from pinn_cli.network.spline import Spline
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import Training
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.training.gradient.lbfgs import Lbfgs

pytestmark = [pytest.mark.cuda, pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")]
EMBEDDED = Mlp(1, 12, "sine", "exact", "fourier")


def problem() -> Problem:
    structure = small_chain()
    record = accelerations(measured(structure, snr_db=40.0).record)
    uncertain = tuple(Parameter(kind, 1, value, 0.05 * value) for kind, value in (("k", 15.0), ("kappa", 100.0)))
    return Problem(structure, record, uncertain)


def on(device: str, training: Training, design: NetworkDesign) -> Estimate:
    return training.solve(JointProblem.of(problem()), design, RunContext(device))


def assert_the_same(training: Training, design: NetworkDesign, limit: float, bands: float | None) -> None:
    cpu, cuda = (on(device, training, design) for device in ("cpu", "cuda"))
    for quantity in QUANTITIES:
        assert relative_error(getattr(cuda.response, quantity), getattr(cpu.response, quantity)) < limit, quantity
        if bands is not None:
            np.testing.assert_allclose(getattr(cuda.std, quantity), getattr(cpu.std, quantity), rtol=bands)
    for one, other in zip(cuda.parameters, cpu.parameters, strict=True):
        assert one.estimate == pytest.approx(other.estimate, rel=limit)


@pytest.mark.parametrize("design", [EMBEDDED, Mlp(2, 24, "sine", "exact")], ids=["features", "dense"])
def test_function_space(design):
    assert_the_same(GaussNewton(), design, 1e-4, 0.01)


@pytest.mark.parametrize("design", [EMBEDDED, Mlp(2, 24, "sine", "exact")], ids=["mlp", "dense"])
def test_the_same_device_gives_the_same_numbers(design):
    first, second = (on("cuda", GaussNewton(), design) for _ in range(2))
    np.testing.assert_array_equal(first.response.displacement, second.response.displacement)
    np.testing.assert_array_equal(first.std.acceleration, second.std.acceleration)


@pytest.mark.parametrize("design", [EMBEDDED, Spline()], ids=["mlp", "spline"])
@pytest.mark.parametrize(
    "training",
    [Adam(30, collocation_points=None, dtype="float64"), Lbfgs(20, collocation_points=None, dtype="float64")],
    ids=["adam", "lbfgs"],
)
def test_gradients(training, design):
    assert_the_same(training, design, 1e-3, None)


@pytest.mark.parametrize(("network", "there"), [("spline", False), ("mlp", True)])
def test_a_run_says_which_device_it_used_and_can_be_taken_up(pinn_run: PinnRun, network: str, there: bool):
    outcome = pinn_run(*SMALL, f"network={network}", "device=cuda", "figures=false", "hydra.run.dir=run").done()
    told = outcome.record
    assert told["device"].startswith("cuda (") == there
    assert told["peak_memory_mib"]["cuda"] > 0 or not there
    assert pinn_run("resume=run").status == 0
