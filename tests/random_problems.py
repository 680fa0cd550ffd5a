"""Estimation problems of any kind, as Hypothesis draws them: what is drawn decides their form, a seed their numbers."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from hypothesis import strategies as st
from scipy.sparse import csc_matrix, diags

from pinn_cli.model.knowledge import EndState, ParameterKnowledge
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.network import CONTINUITIES
from pinn_cli.network.spline import Spline
from pinn_cli.record.channel import CALIBRATED, Calibration, Channel
from pinn_cli.record.data_channels import FELT_BY
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import BEGINNINGS, FREE, GAUSSIAN_PROCESS, THROUGH, Problem, TurningPoints
from pinn_cli.system.building import damped
from pinn_cli.system.finite_elements import FiniteElements
from pinn_cli.system.quantities import CONNECTION_FORCE, FORCE, GROUND, HIGH_PASS, MOTION, SUPPORT, TILT
from pinn_cli.system.reduction import WholeModel, reduced_model
from pinn_cli.system.structure import Structure
from pinn_cli.system.substructures import Parts
from pinn_cli.system.topology import build_structure, connected
from pinn_cli.training.estimator import built
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import starting_noise

SAMPLES, STEP, START = 30, 0.1, 2.0
# Settings, and parameters beside c and k, of a connection of every law; some share a kind of parameter.
LAWS: dict[str, dict[str, Any]] = {
    "linear": {},
    "duffing": {"kappa": 30.0},
    "van_der_pol": {"mu": 0.7},
    "power_damping": {"exponent": 2.0, "mu": 0.7},
    "polynomial": {"k_2": 3.0, "k_3": 20.0},
    "friction": {"F_c": 1.4},
    "bouc_wen": {"A": 9.0, "beta": 2.0, "gamma": -0.6, "n": 1.8},  # below 1 it has a corner where it is nothing
    "baber_noori": {
        "A": 9.0,
        "beta": 2.0,
        "gamma": -0.6,
        "n": 1.8,
        "delta_nu": 0.3,
        "delta_eta": 0.2,
        "zeta_s": 0.5,
        "q": 0.2,
        "p": 0.8,
        "psi": 0.5,
        "delta_psi": 0.1,
        "lambda": 0.6,
        "reference": 0.5,
    },
    "jenkins": {"k_t": 9.0, "F_c": 2.5},
    "gap": {"k_g": 9.0, "gap": 0.4},
    "spline": {"elongation": 1.0} | {f"g_{i}": 4.0 / i for i in range(1, 31)},
}
WITH_MEMORY = ("bouc_wen", "baber_noori", "jenkins")
DAMPING = (None, {"ratio": 0.05}, {"rayleigh": [0.1, 0.02]}, {"ratio": [0.05, 0.02]})
CALIBRATION = {
    "gain": Calibration(1.2, 0.4, unknown=True),
    "offset": Calibration(0.3, 0.7, unknown=True),
    "drift": Calibration(-0.1, 0.2, unknown=True),
    "delay": Calibration(0.04, 0.03),
    TILT: Calibration(0.3, 0.5, unknown=True),
    HIGH_PASS: Calibration(0.2, 0.1),
}

Generator = np.random.Generator


def generators() -> st.SearchStrategy[Generator]:
    return st.integers(0, 2**16).map(np.random.default_rng)


def some(draw: st.DrawFn, of: Any, least: int = 0) -> list[Any]:
    """Half of several, in their order, or the first ones."""
    of = list(of)
    return [x for x in of if draw(st.booleans())] or of[:least]


@st.composite
def connections(draw: st.DrawFn, plain: bool, dofs: list[str], supports: list[str]) -> dict[str, Any]:
    """A chain of the DOFs from the ground or from a support, and perhaps a brace or what feels a weighted sum."""
    rng, laws = draw(generators()), [law for law in LAWS if law not in WITH_MEMORY]
    laws += [] if plain else 3 * WITH_MEMORY
    chain = zip([*supports, "ground"][:1] + dofs, dofs, strict=False)
    ends: list[dict[str, Any]] = [{"between": list(pair)} for pair in chain]
    if draw(st.booleans()):
        ends.append({"between": ["ground", dofs[-1]]})
    if draw(st.booleans()):
        ends.append({"weights": {dofs[0]: 0.8, (supports or dofs)[-1]: -0.6}})
    out = {}
    for i, between in enumerate(ends):
        name = draw(st.sampled_from(laws))
        own = {"c": 1.0, "k": 15.0, **LAWS[name]}
        out[f"e{i}"] = {**between, "law": name} | {kind: value * rng.uniform(0.6, 1.4) for kind, value in own.items()}
    return out


@st.composite
def structures(draw: st.DrawFn, plain: bool) -> Structure:
    """Masses with connections of any law, damped as a whole or on a support that moves; or a few modes of many."""
    if not plain and draw(st.integers(0, 3)) == 0:
        return draw(reduced())
    dofs = draw(st.permutations([f"x{i}" for i in range(draw(st.integers(1, 3)))]))
    supports = [] if plain else draw(st.sampled_from(([], [], ["s"])))
    mass = {name: 10.0 - i for i, name in enumerate(dofs)}
    damping = None if supports else draw(st.sampled_from(DAMPING[: 4 if len(dofs) > 1 else 3]))
    joined = draw(connections(plain, dofs, supports))
    return build_structure(sorted(dofs), mass, joined, damping=damping, supports=supports)


@st.composite
def reduced(draw: st.DrawFn) -> Structure:
    """Modes of a chain of five masses and static responses beside them; factors on its parts, connections at DOFs."""
    rng, names = draw(generators()), ("a", "b", "c")
    M, stretch = diags(rng.uniform(0.8, 1.2, 5)), diags([1.0, -1.0], [0, -1], shape=(5, 5))
    each = [csc_matrix(stretch.T @ diags(np.where(which, rng.uniform(20, 40, 5), 0.0)) @ stretch)
            for which in (np.arange(5) < 2, np.arange(5) >= 2)]  # fmt: skip
    own = None
    if draw(st.booleans()):
        own = connected(names, [1.0] * 3, draw(connections(False, list(names), [])))
    parts = Parts(*({"low": x} for x in (each[0], 0.9))) if draw(st.booleans()) else Parts({}, {})
    static = np.array(draw(st.sampled_from(([], [2]))), dtype=int)
    whole = WholeModel(csc_matrix(M), each[0] + each[1], tuple(parts.matrices.values()), static, np.array([0, 2, 4]))
    damping = draw(st.sampled_from(DAMPING))
    model = FiniteElements(whole, names, None, 0.0 if damping else 0.03, parts, own, np.ones(5))
    return damped(model.structure(reduced_model(whole.M, whole.K, 2, static)), damping)


@st.composite
def channels(draw: st.DrawFn, structure: Structure, inputs: dict[str, list[int]], number: int) -> Channel:
    """A sensor with samples of its own, of the motion, of inputs by the DOFs that they have, or of a connection."""
    rng, n = draw(generators()), structure.ndof
    quantity, weights, connection = (
        draw(st.sampled_from((*MOTION, *MOTION[2:], *inputs, CONNECTION_FORCE, CONNECTION_FORCE))),
        {},
        -1,
    )
    if quantity in MOTION:
        felt = some(draw, range(n), 1)
        weights = dict(zip(felt, rng.normal(size=len(felt)) if len(felt) > 1 else [1.0], strict=True))
    elif quantity == FORCE:
        weights = {draw(st.sampled_from(inputs[FORCE])): 1.0}
    elif quantity == CONNECTION_FORCE:
        connection = draw(st.sampled_from([*structure.memory.tolist(), *range(structure.incidence.shape[0])]))
    order = draw(st.integers(0, 2)) if inputs and quantity in FELT_BY[HIGH_PASS] else 0
    doubts = [kind for kind in CALIBRATION if kind != HIGH_PASS and quantity in FELT_BY.get(kind, (quantity,))]
    calibration = {kind: CALIBRATION[kind] for kind in some(draw, doubts) + [HIGH_PASS] * (order > 0)}
    time = START + np.sort(rng.uniform(0.0, STEP * (SAMPLES - 1), 24))
    values, fills = rng.normal(size=len(time)), quantity != CONNECTION_FORCE
    return Channel(f"g{number}", quantity, weights, time, values, calibration, connection, fills, order)


@st.composite
def records(draw: st.DrawFn, structure: Structure, plain: bool) -> Record:
    """Noise in any columns and channels, one plain sensor of the motion at least; of plain ones no input is unknown."""
    rng, n, time = draw(generators()), structure.ndof, START + STEP * np.arange(SAMPLES)
    forced, left_open = some(draw, range(n)), draw(st.integers(0, 3)) == 0
    moves = not plain and draw(st.booleans())
    force = np.zeros((SAMPLES, n))
    force[:, forced] = rng.normal(size=(SAMPLES, len(forced)))
    force[:, forced[: int(left_open)]] = np.nan
    columns = {name: np.full((SAMPLES, n), np.nan) for name in MOTION}
    for quantity, dof in some(draw, [(q, dof) for q in MOTION for dof in range(n)], 1):
        columns[quantity][:, dof] = rng.normal(size=SAMPLES)
    supports = {}
    if structure.supports:
        measured = draw(st.sampled_from(list(SUPPORT)))
        supports[measured] = rng.normal(size=(SAMPLES, structure.supports))
    missed = moves and not left_open and draw(st.integers(0, 3)) == 0
    ground = np.full((SAMPLES, 1), np.nan) if missed else rng.normal(size=(SAMPLES, 1)) if moves else None
    loads = [dof for dof in forced if np.isfinite(force[0, dof])]
    inputs = {} if plain else {FORCE: loads} if loads else {}
    inputs |= {GROUND: []} if moves and not missed else {}
    every: list[Channel] = []
    for number in range(draw(st.integers(0 if plain else 1, 2))):
        channel = draw(channels(structure, inputs, number))
        others = [other for other in every if other.is_column and other.place == channel.place]
        shown = {**columns, FORCE: force, GROUND: ground}.get(channel.quantity)
        taken = channel.quantity in MOTION and channel.is_column and np.isfinite(shown[0, channel.dof])
        channel = replace(channel, fills=channel.fills and not others and not taken)
        if channel.is_column:
            shown[:, channel.dof] = channel.history(time)
        every.append(channel)
    held = not moves and not supports and not structure.is_modal and draw(st.booleans())
    return Record(
        time, **columns, force=force, unforced=~np.isin(np.arange(n), forced), calibrated=tuple(every),
        intersample="zero_order_hold" if held else "band_limited", ground_acceleration=ground[:, 0] if moves else None,
        frame=draw(st.sampled_from(("absolute", "relative"))) if moves else "absolute",
        supports=supports, support_names=structure.labels.supports,
    )  # fmt: skip


def goes_on(problem: Problem, rng: Generator) -> Problem:
    """The same from where an earlier record ended: of parameters and of the first state much is known already."""
    p, dynamics = len(problem.uncertain), problem.dynamics
    states = 2 * dynamics.ndof + len(problem.structure.memory)
    correlation = np.corrcoef(rng.normal(size=(p + states, 2 * (p + states))))
    unit = np.concatenate(([q.prior_std for q in problem.uncertain], rng.uniform(0.5, 2.0, states)))
    covariance, nothing = correlation * np.outer(unit, unit), np.zeros(p)
    state = EndState(0.0, rng.normal(size=states), covariance[p:, p:], covariance[p:, :p])
    mean = np.array([q.prescribed for q in problem.uncertain])
    prior = ParameterKnowledge(mean, covariance[:p, :p], nothing, nothing, unit[:p])
    return replace(problem, prior=prior, initial_state=state)


@st.composite
def problems(draw: st.DrawFn, plain: bool) -> JointProblem:
    """One record or two of one structure, with any of its parameters uncertain."""
    structure, rng = draw(structures(plain)), draw(generators())
    own = [draw(records(structure, plain)) for _ in range(draw(st.integers(1, 2)))]
    uncertain = tuple(
        replace(p, prior_std=rng.uniform(0.1, 0.3) * (abs(p.prescribed) or 1.0), unknown=draw(st.booleans()))
        for p in some(draw, structure.every_parameter())
    )
    through = draw(st.sampled_from(THROUGH)) if plain else THROUGH[0]
    begins, force = draw(st.sampled_from(BEGINNINGS)), FREE if plain else GAUSSIAN_PROCESS
    problem = JointProblem.of_records(structure, own, uncertain, through, begins, force)
    further = draw(st.sampled_from((None, None, "state", "turns")))
    if further == "turns":
        first, *others = problem
        turning = replace(first, turning_points=TurningPoints(np.array([START + 1.0]), 0.1, 5.0, 1.0))
        return JointProblem.of(turning, *others)
    return JointProblem.of(goes_on(problem.alone, rng)) if further == "state" and len(own) == 1 else problem


@st.composite
def equations(draw: st.DrawFn, plain: bool) -> list[NormalEquations]:
    """Of every record of a problem, with any network that can be trained on it.

    Args:
        draw: Of Hypothesis.
        plain: Whether nothing but the motion of DOFs is unknown, beside parameters.
    """
    problem = draw(problems(plain))
    designs = st.builds(Spline, degree=st.sampled_from((6, 6, 5)), intervals=st.sampled_from((5, 11)))
    if not any(own.record.calibrated for own in problem):
        designs |= st.builds(Fourier, harmonics=st.just(4))
    design = draw(designs)
    if plain and not any(own.record.calibrated for own in problem):
        design = replace(design, continuity=draw(st.sampled_from(CONTINUITIES)))
    return [NormalEquations(built(design, own), own) for own in problem]


def noise_of(equations: NormalEquations, seed: Generator | int = 0) -> NoiseModel:
    """Where the levels start, each of them moved."""
    noise, rng = starting_noise(equations), np.random.default_rng(seed)

    def moved(x: np.ndarray) -> np.ndarray:
        return x * rng.uniform(0.5, 2.0, x.shape)

    return replace(
        noise,
        response={quantity: moved(levels) for quantity, levels in noise.response.items()},
        force=moved(noise.force),
        discrepancy=noise.discrepancy * rng.uniform(0.1, 1.0),
        innovation=None if noise.innovation is None else moved(noise.innovation),
        taken_up=rng.uniform(0.0, 9.0, len(noise.response[CALIBRATED])) if CALIBRATED in noise.response else None,
    )


def somewhere(equations: NormalEquations, seed: Generator | int = 0) -> Point:
    """A point, or a step, of which nothing is zero."""
    start, rng = equations.start(), np.random.default_rng(seed)
    return Point(*(torch.as_tensor(0.3 * rng.normal(size=x.shape)) for x in (start.unknowns, start.parameters)))
