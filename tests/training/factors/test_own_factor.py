"""A prior of one's own, as docs/develop.md says: a class with a loss and rows, and an entry of the list."""

import numpy as np
import pytest
from one_record import evidence_of, levels_of, shown_noise
from small_problems import measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.factors.factor import Factor
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.point import Point


class Still(Factor):
    """The readout is small: each weight to a standard deviation."""

    name = "still"

    def __init__(self, frame: NormalEquations, deviation: float) -> None:
        super().__init__(frame)
        self.weight = deviation**-2

    def loss(self, point: Point, noise: NoiseModel) -> float:
        return self.weight * float(point.unknowns.square().sum())

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        sums.add_diagonal(self.weight, point.unknowns.cpu().numpy())


@pytest.mark.parametrize("deviation", [1e3, 1e-6])
def test_it_counts_like_all_others(deviation: float) -> None:
    record = measured(small_chain("linear"), snr_db=40.0, duration=6.0).record
    problem = Problem(small_chain("linear"), record)
    plain, believed = (NormalEquations(Spline().build(record), problem) for _ in range(2))
    believed.factors.append(Still(believed, deviation))
    noise = levels_of(shown_noise(record, 0.01))
    size = {}
    for own in (plain, believed):
        trained = evidence_of(own).train(noise, own.start())
        assert trained.solution.converged
        size[own] = float(np.abs(trained.solution.point.unknowns).max())
    lost = believed.losses(trained.solution.point, noise.records[0])["still"]
    assert lost == pytest.approx(deviation**-2 * float(trained.solution.point.unknowns.square().sum()))
    assert (
        size[believed] == pytest.approx(size[plain], rel=1e-3)
        if deviation > 1.0
        else size[believed] < 0.1 * size[plain]
    )
