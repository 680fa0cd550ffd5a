"""Parameters of the chain under gradient training: learned, bounded, believed and unknown."""

import math
from dataclasses import replace

import pytest
import torch
from calls import Compose
from small_problems import QUANTITIES, accelerations, measured, small_chain

from pinn_cli.cli.config import RunConfig
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.training.gradient.lbfgs import GRADIENT_VANISHED, NOTHING_LOWER, Lbfgs
from pinn_cli.training.gradient.losses import LearnedParameters, Losses

SHORT = Adam(20, collocation_points=128, history_every=10)
LONG = Adam(400, stages=1, learning_rate=1e-2, parameter_learning_rate=5e-3, collocation_points=None)
# Steps as long as the parameter itself throw it about; only its bound keeps it from falling below zero.
WILD = Adam(20, stages=1, parameter_learning_rate=1.0, dtype="float64", collocation_points=None, history_every=10)


@pytest.mark.parametrize(("prior", "found"), [(0.3, 15.0), pytest.param(1e-4, 18.0, marks=pytest.mark.slow)])
def test_a_parameter_is_learned_unless_a_narrow_prior_holds_it(prior, found):
    record = measured(small_chain("linear", ndof=1), snr_db=40.0).record
    wrong = small_chain("linear", ndof=1, k=18.0)
    problem = Problem(wrong, record, (replace(wrong.parameter("k", 0), prior_std=18.0 * prior),))
    (learned,) = LONG.solve(JointProblem.of(problem), Fourier(), RunContext()).parameters
    assert (learned.name, learned.prescribed) == ("k_1", 18.0)
    assert learned.estimate == pytest.approx(found, rel=0.02 if found == 15.0 else 0.01)
    assert all(math.isnan(value) for value in (learned.std, learned.lower_90, learned.upper_90))


def test_parameters_come_in_the_order_of_the_problem():
    structure = small_chain()
    chosen = (structure.parameter(*which) for which in (("kappa", 2), ("c", 0), ("k", 1)))
    order = tuple(replace(p, prior_std=0.1 * p.prescribed) for p in chosen)
    record = accelerations(measured(structure, snr_db=40.0).record)
    estimate = SHORT.solve(JointProblem.of(Problem(structure, record, order)), Spline(), RunContext())
    assert [(p.name, p.prescribed) for p in estimate.parameters] == [("kappa_3", 100.0), ("c_1", 1.0), ("k_2", 15.0)]
    assert all(p.estimate != p.prescribed for p in estimate.parameters)
    assert {"loss_prior", "weight_prior"} <= set(estimate.history)


def one_mass_unknown(start: float, **settings) -> Problem:
    """A linear one-mass chain with every sensor, its stiffness unknown and the others fixed."""
    structure = small_chain("linear", ndof=1)
    every = {"unobserved": [], "sensors": dict.fromkeys(QUANTITIES, True), "parameter_uncertainty": 0.0}
    scheme = StateParameter(**every, unknown="k_1", initial={"k_1": start}, **settings)
    return scheme.pose(structure, [scheme.observe(measured(structure, snr_db=40.0).record)]).alone


def test_an_unknown_parameter_moves_from_its_start_to_the_truth():
    problem = one_mass_unknown(5.0)
    (learned,) = LONG.solve(JointProblem.of(problem), Fourier(), RunContext()).parameters
    start = problem.uncertain[0].prescribed
    assert (learned.name, learned.prescribed, learned.unknown) == ("k_1", start, True)
    assert abs(start - 15.0) > 3.0
    assert abs(learned.estimate - 15.0) < 0.3 * abs(start - 15.0)
    assert learned.prior_std == problem.uncertain[0].prior_std > 5.0 * 15.0
    assert all(math.isnan(value) for value in (learned.std, learned.lower_90, learned.upper_90))


def test_by_curvature_it_comes_to_the_truth():
    training = Lbfgs(iterations=100, warm_up=0, collocation_points=None)
    estimate = training.solve(JointProblem.of(one_mass_unknown(5.0, positive=["k"])), Fourier(), RunContext())
    assert estimate.parameters[0].estimate == pytest.approx(15.0, rel=0.03)
    assert estimate.summary["stop_reason"] in (GRADIENT_VANISHED, NOTHING_LOWER, "iteration limit")


@pytest.mark.parametrize(
    ("training", "start", "positive"),
    [(WILD, 5.0, ["k"]), (WILD, 5.0, []), (Lbfgs(iterations=40, warm_up=0, collocation_points=None), 0.05, ["k"])],
    ids=["adam", "adam, free", "lbfgs"],
)
def test_a_positive_parameter_is_never_below_zero(monkeypatch, training, start, positive):
    seen, terms = [], Losses.terms

    def watched(self: Losses, network, parameters) -> dict[str, torch.Tensor]:
        seen.append(float(parameters()["k"].detach()[0]))
        return terms(self, network, parameters)

    monkeypatch.setattr(Losses, "terms", watched)
    training.solve(JointProblem.of(one_mass_unknown(start, positive=positive)), Fourier(), RunContext())
    assert (min(seen) >= 0.0) == bool(positive)
    if training is WILD:
        assert len(seen) == 21
        assert (min(seen) == 0.0) == bool(positive)


def test_believed_and_unknown_parameters_are_told_apart():
    structure = small_chain()
    scheme = StateParameter(unobserved=[2], parameter_uncertainty=0.05)
    problem = scheme.pose(structure, [scheme.observe(measured(structure, snr_db=40.0).record)]).alone
    estimate = SHORT.solve(JointProblem.of(problem), Spline(), RunContext())
    assert [p.name for p in estimate.parameters if p.unknown] == ["k_2", "kappa_2"]
    assert [p.prior_std for p in estimate.parameters] == [p.prior_std for p in problem.uncertain]
    assert estimate.correlation is None


SHRUNK = ("system.ndof=5", "simulation.duration=12", "simulation.samples=256", "excitation.band=[0.2,1.5]", "threads=1")
STATE_PARAMETER = "experiment=paper_training_state_parameter"


@pytest.mark.parametrize(
    ("experiment", "starts"),
    [
        (STATE_PARAMETER, {"k_2": 10.0, "k_4": 10.0, "kappa_2": 75.0, "kappa_4": 75.0}),
        (
            "experiment=[paper/sp_5dof_van_der_pol,paper_training_state_parameter]",
            {"k_2": 10.0, "k_4": 10.0, "mu_2": 1.0, "mu_4": 1.0},
        ),
    ],
    ids=["duffing", "van_der_pol"],
)
def test_the_configuration_has_the_papers_settings_of_state_parameter_estimation(composed: Compose, experiment, starts):
    config = RunConfig.read(composed(experiment, *SHRUNK))
    training, network, scheme = config.training, config.network, config.scheme
    assert isinstance(training, Adam)
    assert isinstance(network, Mlp)
    assert isinstance(scheme, StateParameter)
    assert (training.iterations, training.stages, training.physics_growth) == (200_000, 2, 10.0)
    assert (training.learning_rate, training.parameter_learning_rate) == (1e-3, 5e-4)
    assert (training.betas, training.weight_decay) == ((0.99, 0.999), 1e-5)
    assert training.weights == {"observation": 1.0, "continuity": 1.0, "physics": 100.0, "unforced": None}
    assert (training.collocation_points, training.dtype) == (4096, "float32")
    assert (network.depth, network.width, network.activation, network.continuity) == (4, 256, "tanh", "penalised")
    _, prescribed = config.model_error.structures(config.structure)
    problem = scheme.pose(prescribed, [config.observe(config.source.measure(config.structure).record)]).alone
    assert problem.acceleration_through == "both"
    assert {p.name: p.prescribed for p in problem.uncertain} == starts
    assert all(p.unknown and p.positive for p in problem.uncertain)
    assert problem.record.observed.tolist() == [True, False, True, False, True]


UNCERTAIN = (
    Parameter("k", 1, 1.5, 255.0, scale=25.5, unknown=True, positive=True),
    Parameter("kappa", 0, 7.3, 1e3, scale=123.4, unknown=True, positive=True),
    Parameter("c", 2, 1.1, 0.1),
)


def learned(dtype: torch.dtype = torch.float32) -> LearnedParameters:
    structure = small_chain()
    values = {kind: value.clone() for kind, value in structure.parameters.items()}
    for p in UNCERTAIN:
        values[p.kind][p.index] = p.prescribed
    record = measured(structure, duration=3.0, samples=33).record
    return LearnedParameters(Problem(structure.with_parameters(**values), record, UNCERTAIN), dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_step_is_counted_in_the_parameters_own_unit(dtype):
    parameters = learned(dtype)
    with torch.no_grad():
        parameters.moved += torch.tensor([0.1, 1.0, -0.2], dtype=dtype)
    values = {kind: value.detach() for kind, value in parameters().items()}
    rounding = 1e-6 if dtype == torch.float32 else 1e-15
    assert float(values["k"][1]) == pytest.approx(1.5 + 2.55, rel=rounding)
    assert float(values["kappa"][0]) == pytest.approx(7.3 + 123.4, rel=rounding)
    assert float(values["c"][2]) == pytest.approx(0.8 * 1.1, rel=rounding)
    assert float(values["k"][0]) == 15.0
    assert [p.estimate for p in parameters.estimates()] == pytest.approx([4.05, 130.7, 0.88], rel=rounding)
    assert float(parameters.prior().detach()) == pytest.approx(0.01**2 + 0.1234**2 + 2.2**2, rel=1e-6)
