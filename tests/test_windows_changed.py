"""A stiffness that falls while a record is solved window by window: told, once, and only where it fell."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from independent_records import Structure, measured
from storeys import RATE, C, K, M, response, system, written

from pinn_cli.record.response import Response

DURATION = 30.0
# Windows of 9 s each 7 s: 0 to 9, 7 to 16, 14 to 23, 21 to 30.
WINDOWS = ("data.window=9", "data.overlap=2")
BEGINS = (0.0, 7.0, 14.0, 21.0)


def softened(seed: int, when: float, left: float) -> Response:
    """Motion whose second spring falls to a part of its stiffness at a time, s."""
    first = response(seed, duration=when)
    state = response(seed, duration=when + 1.0 / RATE)
    start = np.append(state.displacement[-1], state.velocity[-1])
    second = response(seed, K * np.array([1.0, left, 1.0]), DURATION - when, start, when)
    both = ("time", "displacement", "velocity", "acceleration", "force")
    return Response(*(np.concatenate([getattr(one, name) for one in (first, second)]) for name in both))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "when", "left"),
    [
        (2, 18.0, 0.92),  # inside one
        (3, 15.0, 0.95),  # in what two have in common
        (4, 26.0, 0.9),  # in the last one
        (5, 18.0, 1.0),
    ],
)
def test_a_change_is_told_where_it_is(pinn_run: PinnRun, tmp_path: Path, seed: int, when: float, left: float) -> None:
    truth = softened(seed, when, left)
    structure = Structure(M, C, K, np.zeros(3))
    data = written(measured(structure, truth, {"acceleration": (1, 2, 3)}, 30.0, seed).record, tmp_path / "one.csv")
    known = (*system(1.02 * K), "scheme.parameter_uncertainty=0.05")
    pinn_run(*known, *data, *WINDOWS, "hydra.run.dir=run").done()
    told = pd.read_csv("run/windows.csv", keep_default_na=False).set_index("window")["changed"].str.split()
    flagged = [number for number, names in told.items() if names]
    if left == 1.0:
        assert not flagged, told
        return
    containing = [number for number, begin in enumerate(BEGINS, start=1) if begin - 0.5 / RATE < when < begin + 9.0]
    assert len(flagged) == 1, told
    assert flagged[0] in containing
    # A window that holds both values has a model that is wrong: what else moves in it is named after it.
    assert told[flagged[0]][0] == "k_2"
    found = pd.read_csv("run/parameters.csv").set_index("parameter").loc["k_2"]
    if flagged[0] < 4:  # a window that holds both says something between the two
        assert abs(found["estimate"] - left * K[1]) < 3.0 * found["std"]
