"""Natural modes, their damping and frequency responses against closed forms, scipy and difference quotients."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.linalg import eigh
from storeys import chain_matrix
from structures import braced, hysteretic, shuffled

from pinn_cli.model.file import structure_content, structure_of
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain, build_partial_chain
from pinn_cli.system.connection import Duffing, Friction, Linear, PowerDamping, VanDerPol
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.frequency_response import Acting, FrequencyResponse, Seen, rivals_of
from pinn_cli.system.modes import NaturalModes, at_rest
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.topology import build_structure


def uniform(ndof: int = 5, c: float = 0.0):
    return build_chain(ndof, Linear(), m=2.0, c=c, k=800.0)


def test_a_uniform_chain():
    modes = NaturalModes.of(uniform(c=4.0))
    order = np.arange(1, 6)
    omega = 2.0 * np.sqrt(400.0) * np.sin((2 * order - 1) * np.pi / 22.0)
    np.testing.assert_allclose(modes.frequencies, omega / (2.0 * np.pi), rtol=1e-9)
    np.testing.assert_allclose(modes.damping_ratios, 0.5 * 4.0 / 800.0 * omega, rtol=1e-9)
    shapes = np.sin(np.outer(order, (2 * order - 1) * np.pi / 11.0))
    at = np.abs(shapes).argmax(axis=0)
    np.testing.assert_allclose(np.abs(modes.shapes), np.abs(shapes / shapes[at, np.arange(5)]), atol=1e-9)
    assert np.abs(modes.shapes).max(axis=0) == pytest.approx(1.0)


def test_a_damped_oscillator_that_creeps_back():
    modes = NaturalModes.of(build_chain(1, Linear(), m=1.0, c=5.0, k=4.0))
    assert modes.frequencies == pytest.approx(2.0 / (2.0 * np.pi))
    assert modes.damping_ratios == pytest.approx(1.25)
    assert np.isnan(modes.poles).all()


def test_damping_that_is_not_proportional_takes_the_poles():
    structure = build_chain(2, Linear(), m=1.0, c=[0.0, 3.0], k=[100.0, 40.0])
    modes = NaturalModes.of(structure)
    matrix = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-140, 40, -3, 3], [40, -40, 3, -3]])
    poles = np.linalg.eigvals(matrix)
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(np.abs(poles))]
    np.testing.assert_allclose(2.0 * np.pi * modes.frequencies, np.abs(poles), rtol=1e-10)
    np.testing.assert_allclose(modes.damping_ratios, -poles.real / np.abs(poles), rtol=1e-9)


def test_what_a_law_is_at_rest_counts():
    van_der_pol = build_chain(2, VanDerPol(), m=1.0, c=1.0, k=10.0, mu=3.0)
    np.testing.assert_allclose(at_rest(van_der_pol)[1], -2.0)
    assert (NaturalModes.of(van_der_pol).damping_ratios < 0).all()
    np.testing.assert_allclose(at_rest(build_chain(2, Friction(0.1), m=1.0, c=1.0, k=10.0, F_c=3.0))[1], 31.0)
    np.testing.assert_allclose(at_rest(build_chain(2, PowerDamping(1.0), m=1.0, c=1.0, k=10.0, mu=3.0))[1], 4.0)
    structure = hysteretic()
    k, _ = at_rest(structure)
    own, hidden = (structure.parameters[kind].numpy() for kind in ("k", "A"))
    np.testing.assert_allclose(k, [own[0], *(own[1:] + hidden)])
    B, root = structure.incidence.matrix.toarray(), np.diag(structure.parameters["m"].numpy())
    undamped = structure.with_parameters(c=torch.zeros(3, dtype=torch.float64))
    exact = eigh(B.T @ np.diag(k) @ B, root, eigvals_only=True)
    np.testing.assert_allclose(NaturalModes.of(undamped).squares, exact, rtol=1e-9)


def test_a_body_that_nothing_holds():
    modes = NaturalModes.of(build_chain(2, Linear(), m=1.0, c=[0.0, 0.1], k=[0.0, 10.0]))
    assert modes.frequencies == pytest.approx([0.0, np.sqrt(20.0) / (2.0 * np.pi)])
    assert np.isnan(modes.damping_ratios[0])
    np.testing.assert_allclose(modes.shapes[:, 0], 1.0)
    held = build_chain(2, Linear(), m=1.0, c=0.1, k=10.0)
    pushed = NaturalModes.of(held.with_parameters(k=torch.tensor([-5.0, 10.0], dtype=torch.float64)))
    assert np.isnan(pushed.frequencies[0])
    assert np.isfinite(pushed.frequencies[1])


@pytest.mark.parametrize(("kind", "value"), [("k", np.nan), ("m", 0.0)])
def test_no_modes_without_numbers(kind, value):
    structure = uniform()
    values = structure.parameters[kind].clone()
    values[1] = value
    assert NaturalModes.of(structure.with_parameters(**{kind: values})) is None


@pytest.mark.parametrize(
    "structure",
    [braced(), hysteretic(), shuffled(), build_chain(1, Linear(), m=1.0, c=5.0, k=4.0), uniform(3, 1.0)],
    ids=["braced", "hysteretic", "shuffled", "creeping", "chain"],
)
def test_slopes_are_difference_quotients(structure):
    parameters = list(structure.every_parameter())
    slopes = NaturalModes.of(structure).slopes(parameters)
    for column, p in enumerate(parameters):
        step = 1e-4 * abs(p.prescribed)  # a smaller one's quotient has the machine's rounding in it
        above, below = (NaturalModes.of(structure.with_values({p: p.prescribed + x})) for x in (step, -step))
        for slope, name in zip(slopes, ("squares", "damping_ratios"), strict=True):
            quotient = (getattr(above, name) - getattr(below, name)) / (2.0 * step)
            np.testing.assert_allclose(slope[:, column], quotient, rtol=1e-4, atol=1e-7, err_msg=p.name)


def test_modes_find_their_partners():
    one, other = NaturalModes.of(uniform()), NaturalModes.of(uniform(c=1.0))
    np.testing.assert_allclose(one.assurance(other), np.eye(5), atol=1e-12)
    swapped = NaturalModes(other.structure, *(getattr(other, name)[::-1] for name in ("squares", "damping_ratios",
                           "poles")), other.vectors[:, ::-1])  # fmt: skip
    np.testing.assert_array_equal(one.partners(swapped), [4, 3, 2, 1, 0])


K, MASS = [1.5e6, 1.4e6, 1.2e6], 2000.0
BRACED = {
    "s1": {"between": ["ground", "x1"], "law": "linear", "k": 2e6},
    "s2": {"between": ["x1", "x2"], "law": "duffing", "c": 300.0, "k": 1.5e6, "kappa": 1e9},
    "brace": {"weights": {"x2": 0.8}, "law": "linear", "k": 6e5},
}


def chain(damping):
    return build_chain(3, Linear(), damping, m=MASS, k=K)


def braced_pair(damping):
    return build_structure(["x1", "x2"], {"x1": 3000.0, "x2": 2500.0}, BRACED, damping=damping)


def matrices(structure, velocity):
    """M, K and the damping forces at rest, from the structure's own equation."""
    n = structure.coordinates
    m, none = structure.parameters["m"].numpy(), np.zeros(n)
    stiffness = np.stack([structure.restoring_force(1e-9 * row, none) * 1e9 for row in np.eye(n)], axis=1)
    return np.diag(m), stiffness, structure.restoring_force(none, velocity)


@pytest.mark.parametrize(("build", "ratios"), [(chain, [0.02, 0.01, 0.03]), (chain, 0.02), (braced_pair, [0.02, 0.05])])
def test_ratios_are_those_of_the_modes(build, ratios):
    structure = build({"ratio": ratios})
    velocity = np.random.default_rng(0).normal(size=structure.coordinates)
    M, stiffness, felt = matrices(structure, velocity)
    squares, shapes = eigh(stiffness, M)
    expected = M @ shapes @ np.diag(2.0 * np.broadcast_to(ratios, squares.shape) * np.sqrt(squares)) @ shapes.T @ M
    if build is braced_pair:
        expected += 300.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    np.testing.assert_allclose(felt, expected @ velocity, rtol=1e-6)


@pytest.mark.parametrize("build", [chain, braced_pair])
def test_rayleigh_damping_is_proportional_to_mass_and_stiffness(build):
    structure = build({"rayleigh": [0.3, 1e-3]})
    velocity = np.random.default_rng(0).normal(size=structure.coordinates)
    M, stiffness, felt = matrices(structure, velocity)
    felt_alone = felt - (matrices(build({"ratio": 0.0}), velocity)[2])
    np.testing.assert_allclose(felt_alone, (0.3 * M + 1e-3 * stiffness) @ velocity, rtol=1e-6)


def test_they_belong_to_the_modes_of_the_present_structure():
    structure = chain({"ratio": [0.02, 0.01]})
    stiffer = structure.with_values({structure.parameter("k", 0): 3e6})
    np.testing.assert_allclose(NaturalModes.of(stiffer).damping_ratios, [0.02, 0.01, 0.01], rtol=1e-9)
    assert structure.damping_change(stiffer) > 0.1
    assert structure.damping_change(structure.with_values({})) == 0.0


def test_their_names_and_where_they_are_unknown():
    assert [p.name for p in chain({"ratio": 0.02}).every_parameter()][-1] == "zeta"
    assert [p.name for p in chain({"ratio": [0.02, 0.01]}).every_parameter()][-2:] == ["zeta_1", "zeta_2"]
    partial = build_partial_chain(3, Linear(), {"rayleigh": [None, 1e-3]}, m=MASS)
    a_0, a_1 = list(partial.every_parameter())[-2:]
    assert (a_0.name, a_1.name) == ("a_0", "a_1")
    assert np.isnan(a_0.prescribed)
    assert a_1.prescribed == 1e-3
    assert (a_0.owner, a_0.unit, partial.labels.setting(a_0)) == ("the structure", "1/s", "system.damping")


@pytest.mark.parametrize("damping", [{"ratio": [0.02, 0.01]}, {"rayleigh": [0.3, 1e-3]}])
def test_a_run_keeps_them(damping):
    structure = braced_pair(damping)
    again = structure_of(*structure_content(structure))
    u = torch.tensor([0.01, -0.02], dtype=torch.float64)
    torch.testing.assert_close(again.restoring_force(u, u), structure.restoring_force(u, u))
    assert again.present().damping_change(structure) < 1e-12


def test_springs_that_stiffen_count_at_rest():
    cubic = build_chain(3, Duffing(), {"ratio": 0.02}, m=MASS, k=K, kappa=1e10)
    assert cubic.damping_change(chain({"ratio": 0.02})) == 0.0


@pytest.mark.parametrize(
    "damping",
    [0.02, {"ratio": 1.5}, {"ratio": [0.1] * 4}, {"ratios": 0.1}, {"rayleigh": [1.0]}, {"rayleigh": [-1.0, 0.0]}],
)
def test_other_damping_is_refused(damping):
    with pytest.raises(InputError, match="damping"):
        chain(damping)


def test_ratios_of_a_finite_element_model_are_those_with_its_factors(tmp_path):
    stiffness = np.diag([2.9e6, 2.6e6, 1.2e6]) - np.diag([1.4e6, 1.2e6], 1) - np.diag([1.4e6, 1.2e6], -1)
    base = np.diag([1.5e6, 0.0, 0.0])
    np.savez(tmp_path / "whole.npz", M=MASS * np.eye(3), K=stiffness)
    np.savez(tmp_path / "base.npz", base=base)
    structure = build_finite_elements(
        {"x1": 1, "x2": 2, "x3": 3},
        str(tmp_path / "whole.npz"),
        modes=3,
        factors={"base": {"file": str(tmp_path / "base.npz"), "value": 0.7}},
        damping={"ratio": [0.02, 0.01, 0.03]},
    )
    modes = NaturalModes.of(structure)
    expected = eigh(stiffness - 0.3 * base, MASS * np.eye(3), eigvals_only=True)
    np.testing.assert_allclose(modes.frequencies, np.sqrt(expected) / (2.0 * np.pi), rtol=1e-6)
    np.testing.assert_allclose(modes.damping_ratios, [0.02, 0.01, 0.03], rtol=1e-6)


OMEGA = np.array([0.7, 1.9, 5.0])
# Two masses: from the ground, or the support that moves, to the first one and on to the second.
STRETCH = np.array([[1.0, 0.0], [-1.0, 1.0]])
NOTHING = np.zeros(2)
INPUTS = [
    (np.array([0.0, 1.0]), NOTHING, NOTHING),
    (NOTHING, np.ones(2), NOTHING),
    (NOTHING, NOTHING, np.array([-1.0, 0.0])),
]
RESPONSE = FrequencyResponse(
    OMEGA,
    STRETCH,
    np.eye(2)[None],
    Acting.of(INPUTS, 2),
    np.array([2.0, 1.0]),
    3.0 + 0.2j * OMEGA[:, None] * np.ones(2),
)


def test_force_ground_and_support_move_two_masses_as_their_equations_say():
    for omega, found in zip(OMEGA, RESPONSE.value, strict=True):
        d = 3.0 + 0.2j * omega
        dynamic = np.array([[2.0 * d - 2.0 * omega**2, -d], [-d, d - omega**2]])
        pushes = np.array([[0.0, -2.0, d], [1.0, -1.0, 0.0]])  # by the force, the ground's acceleration, the support
        np.testing.assert_allclose(found, np.linalg.solve(dynamic, pushes), rtol=1e-12)


def test_slopes_are_those_of_the_values():
    mass, connection = np.array([0.3, -0.1]), np.outer(1.0 + 1j * OMEGA, [0.0, 0.4])
    ends = [
        replace(RESPONSE, mass=RESPONSE.mass + h * mass, connection=RESPONSE.connection + h * connection).value
        for h in (1e-6, -1e-6)
    ]
    np.testing.assert_allclose(RESPONSE.slope(mass, connection), (ends[0] - ends[1]) / 2e-6, atol=1e-8)


FRAME = build_chain(3, Linear(), m=[2e3, 2e3, 1.5e3], c=1e3, k=[8e6, 7.2e6, 5.6e6])
SPRINGS = [Parameter("k", i) for i in range(3)]
ROOF, EVERY = np.eye(3)[[2]], np.eye(3)


def seen(sensing: np.ndarray, shaken: bool = True) -> Seen:
    one, nothing = np.ones(3) * shaken, np.zeros(3)
    return Seen(sensing, Acting.of([(np.eye(3)[0] * (not shaken), one, nothing)], 3), 0.3, 20.0)


def frequencies(k: list[float]) -> np.ndarray:
    """Written out independently, rad/s."""
    mass = np.array([2e3, 2e3, 1.5e3])
    return np.sqrt(np.linalg.eigvalsh(chain_matrix(np.array(k)) / np.sqrt(np.outer(mass, mass))))


def test_the_roof_of_a_shaken_frame_has_a_twin_with_the_same_frequencies():
    (other,) = rivals_of(FRAME, SPRINGS, seen(ROOF), 3)
    k = [other[p] for p in SPRINGS]
    assert k[0] > 1.5 * 8e6
    np.testing.assert_allclose(frequencies(k), frequencies([8e6, 7.2e6, 5.6e6]), rtol=1e-6)


def test_on_a_support_that_moves_it_has_the_twin_that_it_has_on_moving_ground():
    """The roof moves as the support does and as the frame does beside it: both are told by the same frequencies."""
    acting = Acting.of([(np.zeros(3), np.zeros(3), np.array([-1.0, 0.0, 0.0]))], 3)
    carried = replace(seen(ROOF), acting=acting)
    ((on_support,), (on_ground,)) = (rivals_of(FRAME, SPRINGS, one, 3) for one in (carried, seen(ROOF)))
    np.testing.assert_allclose([on_support[p] for p in SPRINGS], [on_ground[p] for p in SPRINGS], rtol=1e-4)


@pytest.mark.parametrize("looked_at", [seen(EVERY), seen(np.eye(3)[[0]], shaken=False)], ids=["all floors", "driven"])
def test_what_sensors_tell_apart_has_no_twin(looked_at: Seen):
    assert rivals_of(FRAME, SPRINGS, looked_at, 3) == []


def test_parameters_that_are_held_leave_no_room_for_a_twin():
    assert rivals_of(FRAME, SPRINGS[:1], seen(ROOF), 3) == []


def test_behind_a_spring_of_no_stiffness_nothing_is_felt_and_nothing_breaks():
    springs = torch.tensor([100.0, 1e-320, 80.0], dtype=torch.float64)  # of a solution at its lower bound
    structure = build_chain(3, Linear(), m=1.0, c=0.1, k=100.0).with_parameters(k=springs)
    one = np.eye(3)
    seen = Seen(one[[0, 2]], Acting.forces(one[:, [0]]), 0.5, 4.0)
    free = [p for p in structure.every_parameter() if p.kind == "k"]
    assert all(np.isfinite(list(other.values())).all() for other in rivals_of(structure, free, seen, 3))


def test_after_a_release_the_roof_shows_frequencies_alone_and_all_floors_show_the_frame():
    start = np.stack((np.linalg.solve(chain_matrix(np.array([8e6, 7.2e6, 5.6e6])), [1e4, -2e4, 1e4]), np.zeros(3)))
    nothing = Acting.of([], 3)
    (other,) = rivals_of(FRAME, SPRINGS, replace(seen(ROOF), acting=nothing, released=start), 9)
    found = frequencies([other[p] for p in SPRINGS])
    np.testing.assert_allclose(found, frequencies([8e6, 7.2e6, 5.6e6]), rtol=1e-5)
    assert rivals_of(FRAME, SPRINGS, replace(seen(EVERY), acting=nothing, released=start), 9) == []
