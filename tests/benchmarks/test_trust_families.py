"""What families of the referee draw, and the bar of the comparison with the smoother."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import eigh

from benchmarks.against_smoother import compared
from benchmarks.trust.case import plain
from benchmarks.trust.families import degrading, drawn, nonlinear
from benchmarks.trust.families.finite_elements import Mesh, assembled
from benchmarks.trust.structures import Connection, Structure, damping_matrix, linear_motion, simulated, sinusoids
from benchmarks.trust.waves import random_waves
from pinn_cli.record.response import QUANTITIES
from pinn_cli.system.connection.baber_noori import BaberNoori
from pinn_cli.system.connection.bouc_wen import BoucWen
from pinn_cli.system.connection.duffing import Duffing
from pinn_cli.system.connection.friction import Friction
from pinn_cli.system.connection.nonlinearity import Hysteresis
from pinn_cli.system.connection.polynomial import Polynomial
from pinn_cli.system.connection.power_damping import PowerDamping
from pinn_cli.system.connection.van_der_pol import VanDerPol

ROWS = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 1], [0.6, 0, -0.8]])
FRAME = Structure(
    ("a", "b", "c"),
    np.array([2.0, 3.0, 1.5]),
    tuple(Connection(f"s{i}", row, values={"c": 1.5, "k": 4e3}) for i, row in enumerate(ROWS)),
)


@pytest.mark.parametrize(
    ("family", "seed"),
    [
        ("finite_elements", 1),
        ("ground", 5),
        *(
            pytest.param(family, seed, marks=pytest.mark.slow)
            for family, seed in {
                "chain": 0, "topology": 0, "nonlinear": 1, "degrading": 1, "unmeasured": 13, "unmeasured_nonlinear": 3,
                "unknown_law": 2, "lost_ground": 1, "wind": 1, "damping": 4, "sensors": 2, "posterior": 0, "records": 0,
                "spoilt": 0, "transient": 1,
            }.items()
        ),
    ],
)  # fmt: skip
def test_a_seed_draws_the_same_case_again(family: str, seed: int) -> None:
    case, again = drawn(family, seed), drawn(family, seed)
    assert plain(case.settings) == plain(again.settings)
    assert case.truth.parameters == again.truth.parameters
    for name, record in case.records.items():
        pd.testing.assert_frame_equal(record, again.records[name], check_exact=True)
        assert np.isfinite(record["t"]).all()
    samples, dofs = case.truth.displacement.shape
    assert samples == len(next(iter(case.records.values())))
    assert set(case.truth.sensed) < set(range(dofs + 1))


def test_linear_motion_is_that_of_small_steps() -> None:
    frequencies = FRAME.modes()[0]
    force = sinusoids(np.random.default_rng(1), 0.4 * frequencies[0], 1.2 * frequencies[-1], 2.0)
    times = np.arange(0.0, 12.0 / frequencies[0], 0.3 / frequencies[-1])
    place = np.array([0.0, 1.0, -0.5])
    exact = linear_motion(FRAME, lambda t: force(t)[:, None] * place, times, 1.2 * frequencies[-1])
    small = simulated(FRAME, lambda t: force(t) * place, times, 1.2 * frequencies[-1])
    for quantity in ("displacement", "velocity", "acceleration"):
        found, expected = getattr(exact, quantity), getattr(small, quantity)
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_each_mode_has_its_damping_ratio() -> None:
    ratios = np.array([0.01, 0.03, 0.02])
    C = damping_matrix(FRAME, ratios)
    frequencies, shapes = FRAME.modes()
    np.testing.assert_allclose(shapes.T @ C @ shapes, np.diag(4.0 * np.pi * ratios * frequencies), atol=1e-9)


def test_motion_under_waves_is_that_of_small_steps_and_of_the_wave_begun_earlier() -> None:
    frequencies, where = FRAME.modes()[0], np.eye(3)[:, [1, 2]]
    highest, rng = 1.2 * frequencies[-1], np.random.default_rng(2)
    waves = random_waves(rng, (0.4 * frequencies[0], highest), np.array([2.0, 1.0]), 50, np.ones_like)
    times = np.arange(0.0, 12.0 / frequencies[0], 0.3 / frequencies[-1])
    M, C, K = np.diag(FRAME.mass), FRAME.matrix("c"), FRAME.matrix("k")
    exact = waves.moves(M, C, K, where, times)
    small = linear_motion(FRAME, lambda t: waves(t) @ where.T, times, highest)
    later = replace(waves, begin=-times[40]).moves(M, C, K, where, times[:-40])
    for quantity in ("displacement", "velocity", "acceleration"):
        found, expected = getattr(exact, quantity), getattr(small, quantity)
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
        np.testing.assert_allclose(getattr(later, quantity), found[40:], atol=1e-9 * np.abs(found).max())


@pytest.mark.parametrize(
    ("law", "of_the_program"),
    [
        ("duffing", lambda link: Duffing()),
        ("polynomial", lambda link: Polynomial([2, 3])),
        ("bouc_wen", lambda link: BoucWen()),
        ("degrades", lambda link: BaberNoori()),
        ("pinches", lambda link: BaberNoori(pinches=True)),
        ("friction", lambda link: Friction(link.options.get("speed", 1e-4 * 0.3))),
        ("van_der_pol", lambda link: VanDerPol()),
        ("power_damping", lambda link: PowerDamping(link.options["exponent"])),
    ],
)
def test_a_law_that_is_drawn_is_the_one_of_its_name(law, of_the_program):
    rng = np.random.default_rng(3)
    link = (vars(nonlinear) | vars(degrading))[law](rng, replace(FRAME.connections[0]), 0.2, 0.3)
    program = of_the_program(link)
    values = {name: np.array([value]) for name, value in link.values.items()}
    for e, de, z in rng.normal(size=(10, 3)):
        expected = program.force(np.array([e]), np.array([de]), values)[0]
        if isinstance(program, Hysteresis):
            expected, energy = z, 5.0 * abs(e)
            states = [z, energy][: link.remembered]
            found = program.rate(np.array([e]), np.array([de]), [np.array([x]) for x in states], values)
            np.testing.assert_allclose(link.memory(e, de, states), np.concatenate(found))
        assert link.force(e, de, z) == pytest.approx(expected)


def test_a_cantilever_has_the_frequency_of_the_textbook() -> None:
    count, length = 12, 2.0
    nodes = np.column_stack([np.linspace(0.0, length, count + 1), np.zeros(count + 1)])
    elements = np.column_stack([np.arange(count), np.arange(1, count + 1)])
    held = np.r_[3 * np.arange(count + 1), 1, 2]
    for turned in (0.0, 0.7):  # along x without its axial motion, and anywhere in the plane with it
        turn = np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]])
        mesh = Mesh(nodes @ turn, elements, np.arange(count) // 6, held if turned == 0.0 else np.arange(3), 0.01)
        M, K = assembled(mesh)
        first = np.sqrt(eigh(K.sum(0), M, eigvals_only=True)[0])
        assert first == pytest.approx(1.8751**2 / length**2, rel=1e-3)


def test_ours_is_compared_with_the_best_level_of_each_quantity():
    means = {"uncertain": 1.1, "fixed": 1.0, "evidence": 1.2, "process noise 0.1 N": 1.0, "process noise 1 N": 2.0}
    rows = pd.DataFrame(
        {"estimator": name, "snr_db": 20, "seed": seed, **dict.fromkeys(QUANTITIES, value + 0.1 * (2 * seed - 1))}
        for name, value in means.items()
        for seed in (0, 1)
    )
    rows.loc[rows["estimator"] == "process noise 1 N", "force"] = 0.5
    table = compared(rows).set_index(["estimator", "quantity"])
    assert table.loc[("uncertain", "velocity"), "ratio"] == pytest.approx(1.1)
    assert table.loc[("uncertain", "velocity"), "hand_tuned_level"] == "0.1 N"
    assert table.loc[("fixed", "force"), "ratio"] == pytest.approx(2.0)
    assert table.loc[("fixed", "force"), "hand_tuned_level"] == "1 N"
