"""The estimators that `make trust` compares with find what is unknown of linear structures whose truth is known."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.trust.case import Case, Truth
from benchmarks.trust.families import drawn
from benchmarks.trust.peers import MEASURED_INPUTS, compared
from benchmarks.trust.structures import Connection, Structure, noisy, simulated, sinusoids
from benchmarks.trust.told import Input, Sensor, Told


# 27: three storeys, 55 dB, all springs a factor of two too soft; 43: three storeys, 51 dB.
@pytest.mark.parametrize("seed", [27, 43])
@pytest.mark.slow
def test_both_peers_find_the_springs_of_a_chain(seed):
    case = drawn("chain", seed)
    found = compared(case)
    assert set(found["peer"]) == set(MEASURED_INPUTS)
    true = found["parameter"].map(case.truth.parameters)
    assert set(found["parameter"]) == set(case.truth.parameters)
    assert (found["estimate"] / true).to_numpy() == pytest.approx(1.0, abs=0.05)
    assert (found["seconds"] > 0.0).all()


@pytest.mark.slow
def test_a_chain_with_cubic_springs_or_of_known_ones_is_not_for_them():
    assert drawn("chain", 5).peer is None
    assert compared(drawn("chain", 0)).empty


@pytest.mark.slow
def test_both_peers_find_springs_and_dampers_on_a_moving_ground():
    """Three storeys; absolute accelerations of two of them."""
    rng, times, mass = np.random.default_rng(3), np.arange(0.0, 40.0, 0.02), np.array([2e3, 2e3, 1.5e3])
    links = tuple(
        Connection(str(i + 1), row, values={"c": 900.0, "k": k})
        for i, (row, k) in enumerate(zip(np.eye(3) - np.eye(3, k=-1), (8e5, 7e5, 6e5), strict=True))
    )
    structure, ground = Structure(("1", "2", "3"), mass, links), sinusoids(rng, 0.3, 8.0, 1.0)
    motion = simulated(structure, lambda t: -mass * ground(np.array(t)), times, 8.0)
    felt = {f"a{i}": motion.acceleration[:, i] + ground(times) for i in (0, 2)}
    table = {"t": times, "g": noisy(rng, ground(times), 50)}
    table |= {name: noisy(rng, values, 50) for name, values in felt.items()}
    noise = {name: float(values.std()) * 10.0 ** (-50 / 20) for name, values in felt.items()}
    told = Told(
        mass, np.stack([link.row for link in links]),
        {f"k_{i + 1}": (i, 1.3 * link.values["k"]) for i, link in enumerate(links)}
        | {f"c_{i + 1}": (i, 0.6 * link.values["c"]) for i, link in enumerate(links)},
        ("k_1", "k_2", "k_3", "c_1", "c_2", "c_3"), (Input("g", 10.0 ** (-50 / 20), -mass),),
        tuple(Sensor(name, "absolute", int(name[1]), noise[name]) for name in felt),
    )  # fmt: skip
    nothing = np.zeros((0, 3))
    truth = Truth(structure.parameters(), nothing, nothing, nothing, (0, 2))
    found = compared(Case("ground", 0, {"record.csv": pd.DataFrame(table)}, {}, truth, peer=told))
    off = (found["estimate"] / found["parameter"].map(truth.parameters) - 1.0).abs()
    assert off[found["parameter"].str.startswith("k")].max() < 0.02
    assert off[found["parameter"].str.startswith("c")].max() < 0.2


# 11: two storeys, 15: four with three accelerometers; 10 % is known of their parameters.
@pytest.mark.parametrize("seed", [11, pytest.param(15, marks=pytest.mark.slow)])
def test_a_model_updated_to_subspace_modes_is_nearer_than_what_was_believed(seed):
    case = drawn("unmeasured", seed)
    found = compared(case).set_index("parameter")["estimate"]
    assert isinstance(case.peer, Told)
    believed = dict(zip(case.peer.unknown, case.peer.guess, strict=True))
    springs = [name for name in case.truth.parameters if name.startswith("k")]
    off, before = (
        np.mean([(of[name] / case.truth.parameters[name] - 1.0) ** 2 for name in springs]) for of in (found, believed)
    )
    assert off < 0.1 * before


def test_where_one_force_was_measured_or_all_is_known_there_are_no_modes_to_update_to():
    assert drawn("unmeasured", 0).peer is None
    assert drawn("unmeasured", 3).peer is None
