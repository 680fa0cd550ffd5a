"""What a record says against a structure that was given."""

import numpy as np
import pytest

from pinn_cli.inspection.inspection import contradictions
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.structure import Structure


def structure(chain, **changed: list[float]) -> Structure:
    """Springs of the chain, and dampers that have 2 % in the middle of its band."""
    k = chain.K[-1, -1]
    return build_chain(5, Linear(), **({"m": 1.0, "c": 2.0 * 0.02 * k / (2.0 * np.pi * 3.0), "k": k} | changed))


def told(chain, structure: Structure, **factors: float) -> list[str]:
    time, f, _, a = chain.record(60.0, 11)
    signals = [Signal("f", f, "force", "5")]
    signals += [Signal(f"a{i}", factors.get(f"a{i}", 1.0) * a[:, i - 1], "acceleration", str(i)) for i in (1, 3, 5)]
    return contradictions(structure, signals, Sampling.of(time))


def test_a_structure_that_fits_is_told_nothing(chain):
    assert told(chain, structure(chain)) == []


@pytest.mark.parametrize(("factor", "word"), [(-1.0, "negative"), (1.0 / 9.80665, "1/9.80665")])
def test_a_sensor_away_from_the_force_that_is_turned_or_in_another_unit(chain, factor: float, word: str):
    (text,) = told(chain, structure(chain), a3=factor)
    assert "acceleration of DOF 3" in text
    assert word in text


def test_a_mass_that_is_another_one(chain):
    (text,) = told(chain, structure(chain, m=[1.0, 1.0, 1.5, 1.0, 1.0]))
    assert "m_3" in text


def test_sensors_whose_place_is_no_dof_are_left_out(chain):
    time, _, _, a = chain.record(20.0, 1)
    lost = [Signal("a", a[:, 0], "acceleration", "9"), Signal("b", a[:, 1], "acceleration", "")]
    assert contradictions(structure(chain), lost, Sampling.of(time)) == []
