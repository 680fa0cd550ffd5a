"""The whole of a record from its parts."""

from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from pinn_cli.report.netcdf import write_dataset
from pinn_cli.sweep.window_store import Piece, join_responses, stack_tables
from pinn_cli.sweep.windowed_run import verdict_of_windows


def piece(folder: Path, time: np.ndarray, value: float, extra: bool) -> None:
    histories = {"displacement": (("time", "dof"), np.full((len(time), 2), value), {"units": "m"})}
    if extra:
        histories["drift"] = (("time", "connection"), np.full((len(time), 1), value), {"units": "m"})
    coordinates = {
        "time": ("time", time, {"units": "s"}), "dof": ("dof", np.array([1, 2], dtype=np.int32)),
        "observed": ("dof", np.array([True, False])), "connection": ("connection", np.array(["k_1"])),
    }  # fmt: skip
    folder.mkdir()
    write_dataset(xr.Dataset(histories, coords=coordinates, attrs={"title": "of a window"}), folder / "response.nc")


def test_responses_are_joined_where_windows_hand_over(tmp_path):
    time = 0.1 * np.arange(21)
    piece(tmp_path / "1", time, 1.0, False)
    piece(tmp_path / "2", time + 1.5, 2.0, True)
    pieces = [Piece(tmp_path / "1", 1.5 + 1e-9, 0.1), Piece(tmp_path / "2", None, 0.1)]
    join_responses(pieces, tmp_path / "response.nc")
    with xr.open_dataset(tmp_path / "response.nc") as whole:
        np.testing.assert_allclose(whole["time"], 0.1 * np.arange(36), atol=1e-9)
        np.testing.assert_array_equal(whole["displacement"][:, 1], [1.0] * 15 + [2.0] * 21)
        assert np.isnan(whole["drift"][:15]).all()
        np.testing.assert_array_equal(whole["drift"][15:, 0], [2.0] * 21)
        assert whole["observed"].values.tolist() == [True, False]
        assert whole["observed"].dtype == bool
        assert whole["connection"].values.tolist() == ["k_1"]
        assert (whole["displacement"].attrs["units"], whole.attrs["title"]) == ("m", "of a window")


def test_tables_are_stacked_digit_by_digit(tmp_path):
    (tmp_path / "1.csv").write_text("a,b\n1.10,x\n2.20,y\n")
    (tmp_path / "3.csv").write_text("a,b\n0.30,z\n")
    stack_tables([tmp_path / f"{i}.csv" for i in (1, 2, 3)], tmp_path / "all.csv", "window")
    assert (tmp_path / "all.csv").read_text() == "window,a,b\n1,1.10,x\n1,2.20,y\n3,0.30,z\n"
    assert pd.read_csv(tmp_path / "all.csv")["window"].tolist() == [1, 1, 3]


def entry(start: float, word: str, *reasons: str) -> dict[str, object]:
    return {"start": start, "stop": start + 60.0, "verdict": word, "reasons": list(reasons)}


def test_the_worst_window_is_the_verdict():
    same, bad = "the motion is hardly seen", "a sensor clips"
    found = verdict_of_windows([
        entry(0.0, "sound"), entry(50.0, "questionable", same), entry(100.0, "failed", bad, same),
    ])  # fmt: skip
    assert found.word == "failed"
    texts = [finding.text for finding in found.reasons]
    assert texts == [f"50 to 110 s and 1 more windows: {same}", f"100 to 160 s: {bad}"]
    assert verdict_of_windows([entry(0.0, "sound")]).sound
    for words in (("sound", "questionable"), ("questionable", "sound")):  # without a reason
        assert verdict_of_windows([entry(0.0, word) for word in words]).word == "questionable"
