"""A joint that loses strength and stiffness with the energy that it takes, all of its law unknown, by other code."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from solved_records import by_spline

from pinn_cli.record.record import Record
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.topology import build_partial_structure
from pinn_cli.verdict.judge import judge

M, C, RATE, SAMPLES = 1500.0, 900.0, 50.0, 1500
TRUE = {"k": 2e5, "A": 3e5, "beta": 90.0, "gamma": 40.0, "delta_nu": 8e-4, "delta_eta": 5e-4}
UNKNOWN = [f"{kind}_joint" for kind in TRUE]


def rocked(seed: int) -> Record:
    """Acceleration and force of one mass at 40 dB."""
    rng, time = np.random.default_rng(seed), np.arange(SAMPLES) / RATE
    lines = rng.uniform(0.3, 8.0, 120)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(lines))

    def force(t):
        return 350.0 * np.sin(2.0 * np.pi * np.multiply.outer(t, lines) + phase).sum(-1)

    def motion(t, y):
        u, v, z, energy = y
        nu, eta = 1.0 + TRUE["delta_nu"] * energy, 1.0 + TRUE["delta_eta"] * energy
        rate = (TRUE["A"] * v - nu * (TRUE["beta"] * abs(v) * z + TRUE["gamma"] * v * abs(z))) / eta
        return [v, (force(t) - C * v - TRUE["k"] * u - z) / M, rate, z * v]

    states = solve_ivp(motion, (0.0, time[-1]), np.zeros(4), "DOP853", time, rtol=1e-9, atol=1e-12, max_step=0.01).y.T
    assert states[-1, 3] * TRUE["delta_nu"] > 0.3
    acceleration = np.array([motion(*at)[1] for at in zip(time, states, strict=True)])
    noisy = [x + 1e-2 * x.std() * rng.normal(size=SAMPLES) for x in (acceleration, force(time))]
    nothing = np.full((SAMPLES, 1), np.nan)
    return Record(time, nothing, nothing, noisy[0][:, None], noisy[1][:, None], np.array([False]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_its_law_is_identified(seed):
    law = {"law": "baber_noori", "c": C, "k": None, "n": 1.0} | dict.fromkeys(list(TRUE)[1:])
    structure = build_partial_structure(["x"], {"x": M}, {"joint": {"between": ["ground", "x"], **law}})
    record = rocked(seed)
    scheme = StateParameter(unobserved=[], unknown=UNKNOWN, parameter_uncertainty=0.0, initial_motion="rest")
    problem = scheme.pose(scheme.adapted(structure, [record]), [record])
    estimate = by_spline(problem)
    for p in estimate.parameters:
        true = TRUE[p.name.removesuffix("_joint")]
        assert abs(p.estimate - true) < 4.0 * p.std
        assert p.estimate == pytest.approx(true, rel=0.1)
    assert judge(problem.alone, estimate).word == "sound"
