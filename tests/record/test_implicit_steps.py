"""Simulations of laws that are too stiff for explicit steps, against what can be said without any steps."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.ensemble import Members, spread_of
from pinn_cli.record.free_run import free_run
from pinn_cli.record.record import Record
from pinn_cli.record.simulation import Simulation
from pinn_cli.system.connection import Jenkins
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import build_structure

M, K, F_C = 2.0, 800.0, 3.0
OMEGA, TIME = np.sqrt(K / M), np.arange(301) / 200.0
BEFORE, ENDS, SWINGS = 5.4, 0.6, 3  # in F_c / k: the swings end at -3.4, 1.4 and 0.6, and there it sticks


def rubbing(**law: object) -> Structure:
    joint = {"between": ["ground", "x"], "c": 0, "k": K, "F_c": F_C, **law}
    return build_structure(["x"], {"x": M}, {"joint": joint})


def left_alone() -> Record:
    nothing = np.zeros((len(TIME), 1))
    unknown = np.full_like(nothing, np.nan)
    return Record(TIME, nothing, unknown, unknown, nothing, np.array([True]))


def coulomb(time: np.ndarray) -> np.ndarray:
    """Displacement: half a cosine about F_c / k against the motion for each swing, until the spring holds no more."""
    swing = (OMEGA * time // np.pi).astype(int)
    amplitude, side = BEFORE - 1.0 - 2.0 * swing, np.where(swing % 2, -1.0, 1.0)
    moving = side * (amplitude * np.cos(OMEGA * time - np.pi * swing) + 1.0)
    return F_C / K * np.where(swing < SWINGS, moving, ENDS)


@pytest.mark.parametrize("law", [{"law": "friction"}, {"law": "friction", "speed": 1e-5}], ids=["sticks", "creeps"])
def test_a_free_decay_under_friction_ends_where_it_sticks(law):
    found = free_run(rubbing(**law), left_alone(), ([BEFORE * F_C / K], [0.0]))
    expected = coulomb(TIME)
    assert np.abs(found.displacement[:, 0] - expected).max() < 2e-3 * expected.max()
    assert np.abs(found.acceleration[-20:]).max() < 1e-3 * F_C / M


def test_a_stiff_contact_holds_what_friction_holds():
    """It ends within a few of its own yields of where friction without any ends."""
    contact = rubbing(law="jenkins", k_t=3e5, sharpness=20.0)
    found = free_run(contact, left_alone(), ([BEFORE * F_C / K], [0.0]))
    assert np.abs(found.displacement[-1, 0] - coulomb(TIME)[-1]) < 8.0 * F_C / 3e5
    assert found.hidden is not None
    assert np.abs(found.hidden).max() < 1.01 * F_C


def test_a_held_force_above_friction_moves_and_one_below_does_not():
    push = np.where(np.arange(120) < 60, 0.9, 1.2)[:, None] * F_C
    structure = build_structure(
        ["x"], {"x": M}, {"j": {"between": ["ground", "x"], "law": "friction", "c": 0, "k": 0, "F_c": F_C}}
    )
    found = Simulation(119 / 200.0, 120, hold="zero_order").run(structure, lambda _: push)
    since = (np.arange(120) - 60) / 200.0
    np.testing.assert_allclose(found.displacement[:61], 0.0, atol=1e-6)
    np.testing.assert_allclose(found.displacement[60:, 0], 0.2 * F_C / M * since[60:] ** 2 / 2.0, atol=1e-6)


def test_members_that_differ_in_nothing_do_what_one_alone_does():
    structure, start = rubbing(law="friction"), [BEFORE * F_C / K, 0.0]
    one = free_run(structure, left_alone(), (start[:1], start[1:]))
    own = {kind: np.tile(value.numpy(), (3, 1)) for kind, value in structure.parameters.items()}
    own["F_c"] *= np.array([[1.0], [1.0], [1.1]])
    members = Members(own, np.tile(start, (3, 1)), np.zeros((0, 1)), 0)
    two = Members({kind: value[:2] for kind, value in own.items()}, members.start[:2], members.sources, 0)
    assert np.abs(spread_of(two, structure, left_alone(), one).displacement).max() < 1e-5 * F_C / K
    spread = spread_of(members, structure, left_alone(), one).displacement
    assert np.abs(spread).max() > 0.05 * F_C / K


def test_a_contact_dissipates_what_its_slider_does():
    """Over a cycle of amplitude a, 4 F_c (a - F_c / k_t); and less than F_c it holds without any loss."""
    law, parameters = Jenkins(sharpness=60.0), {"k_t": np.array(1e4), "F_c": np.array(F_C)}
    for amplitude, lost in ((5.0 * F_C / 1e4, 4.0 * F_C * 4.0 * F_C / 1e4), (0.9 * F_C / 1e4, 0.0)):
        phase = np.linspace(0.0, 6.0 * np.pi, 6_001)
        e, z = amplitude * np.sin(phase), np.zeros(len(phase))
        for i, de in enumerate(np.diff(e)):
            z[i + 1] = z[i] + law.rate(e[i], np.array(de), z[i : i + 1], parameters)[0]
        last = phase >= 4.0 * np.pi
        assert np.trapezoid(z[last], e[last]) == pytest.approx(lost, abs=2e-2 * 4.0 * F_C * amplitude)
