"""One row per step."""

import numpy as np
import pytest

from pinn_cli.training.history import History
from pinn_cli.training.noise_model import NoiseModel

NOTHING = np.full(2, np.nan)


def noise(force: np.ndarray) -> NoiseModel:
    return NoiseModel(
        {"displacement": NOTHING, "velocity": NOTHING, "acceleration": np.array([0.1, np.nan])}, force, 0.4, 1.0
    )


def test_rows_hold_losses_and_weights():
    history = History(progress=False)
    history.add_step({"physics": 2.0, "prior": 0.5}, noise(np.array([0.3, np.nan])))
    history.add_step({"physics": 1.0, "prior": 0.5}, noise(np.array([0.3, np.nan])))
    table = history.table()
    assert list(table["iteration"]) == [1, 2]
    assert list(table["loss_physics"]) == [2.0, 1.0]
    row = table.iloc[-1]
    assert row["weight_acceleration"] == pytest.approx(100.0)
    assert row["weight_unforced"] == pytest.approx(6.25)
    assert row["weight_forced"] == pytest.approx(4.0)
    assert not {"weight_displacement", "weight_velocity"} & set(table)


def test_without_a_force_sensor_there_is_no_weight_of_one():
    history = History(progress=False)
    history.add_step({"physics": 2.0}, noise(NOTHING))
    assert "weight_forced" not in history.table()


def test_no_progress_bar_is_drawn(capfd):
    with History(progress=False) as history:
        history.add_step({"physics": 2.0}, noise(NOTHING))
    assert capfd.readouterr() == ("", "")
