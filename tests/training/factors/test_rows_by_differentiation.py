"""What every factor adds to the normal equations is the product of its Jacobian, for whatever problem is drawn.

So are determinants and the standard deviations that are reported. The Jacobian is that of automatic differentiation.
Of a sensor's delay and the corner of its filter, for which features and equations are made anew, it is that of central
differences.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st
from random_problems import equations, generators, noise_of, somewhere
from scipy.linalg import block_diag
from scipy.sparse import csr_matrix

from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.runs import side_by_side
from pinn_cli.system.energy import dissipated_power
from pinn_cli.system.functions import Jet
from pinn_cli.system.quantities import GROUND, HIGH_PASS
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.factors import equation_rows, frame
from pinn_cli.training.factors.calibrated_channels import CalibratedChannels, Gains, SensorFilter
from pinn_cli.training.factors.equation_rows import EquationsOfMotion
from pinn_cli.training.factors.factor import Channels, Factor, Residuals
from pinn_cli.training.factors.known_state import KnownState
from pinn_cli.training.factors.ridge import Ridge
from pinn_cli.training.least_squares import LeastSquares
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.bordered import BorderedFactor, BorderedSystem
from pinn_cli.training.normal_matrix.dissection import Dissection
from pinn_cli.training.normal_matrix.elimination import ROUNDING_JITTER
from pinn_cli.training.record_evidence import RecordEvidence
from pinn_cli.training.reported.connection_forces import connection_forces, dissipated_energy

pytestmark = pytest.mark.filterwarnings("ignore:Converting a tensor with requires_grad")
FIXED = settings(derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck))
SPREADS = st.sampled_from((0.3, 1.0, 4.0))
# Of a tenth of that step the rounding of times is a millionth.
DIFFERENCED, LENGTH = ("delay", HIGH_PASS), 1e-5
# Of the step: the diagonal is so much larger, and the system so well conditioned that any two solutions of it agree.
DAMPING = 0.1


class Linearised:
    """Residuals of one record at a point, over their standard deviations, and their Jacobian.

    Without the prior of the parameters, which several records share. Of what the losses hold beside squares, a gain's
    logarithm and a constant pull on the parameters, the gradient has its part and the Hessian none.
    """

    def __init__(self, own: NormalEquations, at: Point, noise: NoiseModel) -> None:
        self.own, self.at, self.noise = own, at, noise
        found = self.residuals(at)
        ends = np.cumsum([0, *map(len, found.values())])
        self.rows = dict(zip(found, map(slice, ends[:-1], ends[1:]), strict=True))
        self.values = torch.cat(list(found.values())).numpy()

    def residuals(self, at: Point) -> dict[str, torch.Tensor]:
        """(rows,) of every factor."""
        out = {}
        for i, factor in enumerate(self.own.factors):
            for j, rows in enumerate(self.of_factor(factor, at)):
                out[f"{factor.name} {i} {j}"] = rows.flatten()
        return out

    def of_factor(self, factor: Factor, at: Point) -> Iterator[torch.Tensor]:
        """Piece by piece; of a sensor sample by sample, since a delay takes samples to other groups."""
        if isinstance(factor, Channels):
            yield from self.of_channels(factor, at, [piece.residual for piece in factor.residuals(at)])
        elif isinstance(factor, Residuals):
            yield torch.cat([r for _, r in factor.residuals(at)]) * factor.weight(self.noise).sqrt()
        elif isinstance(factor, SensorFilter):
            yield factor.weight**0.5 * factor.residual(at)
        elif isinstance(factor, KnownState):
            yield factor.residuals(at)
        elif isinstance(factor, Ridge):
            yield torch.as_tensor(factor.of_unknowns).sqrt() * at.unknowns
        else:
            assert isinstance(factor, Gains)

    def of_channels(self, factor: Channels, at: Point, pieces: Sequence[torch.Tensor]) -> Iterator[torch.Tensor]:
        root = 1.0 / self.noise.response[factor.name]
        if isinstance(factor, CalibratedChannels):
            with torch.no_grad():
                delays = [float(x) for x in self.own.parameters(at)["delay"]]
            for channel, delay, piece, by in zip(factor.channels, delays, pieces, root, strict=True):
                yield channel.moment(delay).segments.scatter(piece) * by
        else:
            yield torch.cat(list(pieces)) * factor.weight(self.noise).sqrt()

    def _along(self, unknowns: torch.Tensor, parameters: torch.Tensor) -> torch.Tensor:
        return torch.cat(list(self.residuals(Point(unknowns, parameters)).values()))

    def differenced(self, function, kinds: Sequence[str]) -> dict[int, float | torch.Tensor]:
        """Central differences of a function of points, by the place of every parameter of some kinds."""
        out = {}
        for i, parameter in enumerate(self.own.uncertain):
            if parameter.kind in kinds:
                step = torch.zeros_like(self.at.parameters).index_fill(0, torch.tensor(i), LENGTH)
                up, down = (function(Point(self.at.unknowns, self.at.parameters + x)) for x in (step, -step))
                out[len(self.at.unknowns) + i] = (up - down) / (2.0 * LENGTH)
        return out

    @cached_property
    def jacobian(self) -> np.ndarray:
        """(rows, size + p)."""
        at = self.at.unknowns, self.at.parameters
        by = torch.cat(torch.autograd.functional.jacobian(self._along, at, vectorize=True), -1)
        for column, slope in self.differenced(lambda at: self._along(at.unknowns, at.parameters), DIFFERENCED).items():
            by[:, column] = slope
        return by.numpy()

    @property
    def hessian(self) -> np.ndarray:
        """(size + p, size + p), of Gauss and Newton."""
        return self.jacobian.T @ self.jacobian

    @cached_property
    def gradient(self) -> np.ndarray:
        """(size + p,)."""
        out = self.jacobian.T @ self.values - np.append(np.zeros(len(self.at.unknowns)), self.own.pull)
        for column, slope in self.differenced(lambda at: self.own.losses(at, self.noise)["gain"], ("gain",)).items():
            out[column] += 0.5 * slope
        return out


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max(initial=1e-300))


def assert_system(system: BorderedSystem, hessian: np.ndarray, gradient: np.ndarray) -> None:
    border = csr_matrix(system.border).toarray()
    found = np.block([[system.band.dense(), border], [border.T, system.corner]])
    scale = np.sqrt(np.diag(hessian))
    assert_close(found / scale / scale[:, None], hessian / scale / scale[:, None])
    assert_close(np.concatenate((system.gradient, system.corner_gradient)) / scale, gradient / scale)


def assert_moves(rows: Linearised, step: Point) -> None:
    """Changes of forces and of what channels show with a small step are products of the Jacobian."""
    own, moved = rows.own, rows.jacobian @ torch.cat((step.unknowns, step.parameters)).numpy()
    for i, factor in enumerate(own.factors):
        if isinstance(factor, Channels):
            found = list(rows.of_channels(factor, rows.at, [x for _, (x,) in factor.moved(rows.at, [step])]))
        elif isinstance(factor, EquationsOfMotion):
            forces = torch.cat([force for _, (force,) in factor.moved(rows.at, [step])])
            found = [forces * factor.weight(rows.noise).sqrt()]
        else:
            continue
        for j, change in enumerate(found):
            assert_close(change.flatten(), moved[rows.rows[f"{factor.name} {i} {j}"]])


def assert_determinants(rows: Linearised, rng: np.random.Generator) -> None:
    """Of the readout weights' Hessian under several noise levels of the sensors."""
    own = rows.own
    other = Linearised(own, rows.at, replace(rows.noise, response=noise_of(own, rng).response))
    found = own.log_determinants(rows.at, [other.noise, rows.noise])
    for of, determinant in zip((other, rows), found, strict=True):
        jacobian = of.jacobian[:, : own.layout.size]
        scale = np.linalg.norm(jacobian, axis=0)
        eigenvalues = np.linalg.svd(jacobian / scale, compute_uv=False) ** 2 + ROUNDING_JITTER
        expected = np.log(eigenvalues).sum() + 2.0 * np.log(scale).sum()
        assert determinant == pytest.approx(expected, abs=1e-7 + (ROUNDING_JITTER / eigenvalues).sum())


def reported(own: NormalEquations, at: Point) -> dict[str, torch.Tensor]:
    """(N, any), what an estimate tells: motion at sensors, every function, forces of DOFs and connections, energy."""
    dynamics, values = own.dynamics, own.parameters(at)
    seen, felt = (Jet(*own.flat_states(segments, at)[:3]) for segments in (own.observation, own.physics))
    structure, motion = dynamics.structure, (*RESPONSE_QUANTITIES, *([GROUND] if dynamics.inputs.ground else ()))
    out = {quantity: dynamics.sensed(quantity, seen) for quantity in motion}
    out |= {f"function {order}": x for order, x in enumerate(seen)}
    if not (structure.is_modal or dynamics.inputs.forces or dynamics.inputs.loads):
        out["force"] = dynamics.external_force(felt, values)
    if len(structure.added):
        out["connection force"] = dynamics.connection_force(seen, values)[:, structure.added]
    if len(structure.added) and not len(structure.memory):
        e, de = (structure.elongation(dynamics.stretching(x)) for x in seen[:2])
        power = dissipated_power(structure, e, de, values)[:, structure.added]
        out["energy"] = torch.trapezoid(power, torch.as_tensor(own.problem.record.time), dim=0)
    return out


def assert_deviations(own: NormalEquations, at: Point, factor: BorderedFactor, covariance: np.ndarray) -> None:
    """Of all that is reported, against the dense covariance of all unknowns and parameters."""
    posterior = ReadoutPosterior(own, at, factor)
    value, told, coarse = reported(own, at), posterior.sensed(own.observation), dict[str, np.ndarray]()
    told |= {f"function {order}": x for order, x in enumerate(posterior.functions(own.observation))}
    told |= {"force": posterior.force(own.physics)} if "force" in value else {}
    if "connection force" in value:
        force, told["connection force"] = connection_forces(posterior)
        assert_close(force, value["connection force"].numpy())
        structure, seen = own.dynamics.structure, own.flat_states(own.observation, at)[:2]
        ends = (structure.elongation(own.dynamics.stretching(x)) for x in seen)
        coarse["connection force"] = structure.unresolved_force(*ends, own.parameters(at))[:, structure.added].numpy()
    if "energy" in value:
        energy, told["energy"] = dissipated_energy(posterior)
        assert_close(energy, value["energy"].numpy())
    assert told.keys() == value.keys()
    some = {name: slice(None, None, 1 if name == "energy" else 7) for name in value}
    along = lambda *z: tuple(x[some[name]].flatten() for name, x in reported(own, Point(*z)).items())  # noqa: E731
    slopes = torch.autograd.functional.jacobian(along, (at.unknowns, at.parameters), vectorize=True)
    for name, by in zip(value, slopes, strict=True):
        rows = torch.cat(by, -1).numpy()
        expected = np.sqrt(np.maximum(((rows @ covariance) * rows).sum(-1), 0.0))
        expected = np.hypot(expected, np.ravel(coarse[name][some[name]])) if name in coarse else expected
        found, least = np.ravel(told[name][some[name]]), 1e-7 * expected.max()
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=least, err_msg=name)


@pytest.mark.parametrize("examples", [8, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("plain", [True, False], ids=["motion alone", "motion, memory and inputs"])
def test_rows(plain: bool, examples: int) -> None:
    drawn = given(equations(plain), generators(), st.booleans(), st.booleans(), SPREADS)(check_rows)
    settings(FIXED, max_examples=examples)(drawn)()


def check_rows(
    each: list[NormalEquations], rng: np.random.Generator, in_pieces: bool, dissected: bool, spread: float
) -> None:
    """Of one record and of two that share parameters: normal equations, losses, what steps change, a damped step."""
    for own in each if dissected else ():
        own.layout.dissection = Dissection(own.layout.dissection.grid, largest=20)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(side_by_side, "usable_cores", lambda: [0])
        if in_pieces:
            patch.setattr(equation_rows, "ROW_NUMBERS_AT_ONCE", 3000)
            patch.setattr(frame, "ROWS_AT_ONCE", 2000)
            patch.setattr(frame, "KEPT_NUMBERS", 0)
        check_together(each, rng, spread)


def check_together(each: list[NormalEquations], rng: np.random.Generator, spread: float) -> None:
    for own in each:
        calibrated = [(g.quantity, *g.weights, g.connection, g.filter_order) for g in own.problem.record.calibrated]
        note(f"{own.network} {own.problem.inputs} {calibrated} {[p.name for p in own.uncertain]}")
        own.pull = rng.normal(size=len(own.uncertain))
    whole = LeastSquares([RecordEvidence(own) for own in each])
    noise = NoiseLevels(tuple(noise_of(own, rng) for own in each), spread)
    point = whole.joined([somewhere(own, rng) for own in each])
    systems, precision = whole.assemble(point, noise), whole.prior_precision(noise).numpy()
    x, count = point.parameters.numpy(), len(point.unknowns)
    hessian = block_diag(np.zeros((count, count)), precision)
    gradient, losses, start = hessian @ np.append(point.unknowns, x), x @ precision @ x, 0
    for i, (own, at, level) in enumerate(zip(each, whole.split(point), noise.records, strict=True)):
        rows, columns, stop = Linearised(own, at, level), whole.columns[i], start + own.layout.size
        prior = block_diag(np.zeros((own.layout.size,) * 2), precision[np.ix_(columns, columns)])
        given = np.append(at.unknowns, at.parameters)
        assert_system(systems.systems[i], rows.hessian + prior, rows.gradient + prior @ given)
        assert_moves(rows, somewhere(own, rng))
        assert_determinants(rows, rng)
        places, start = np.append(np.arange(start, stop), count + columns), stop
        hessian[np.ix_(places, places)] += rows.hessian
        gradient[places] += rows.gradient
        losses += rows.values @ rows.values - 2.0 * own.pull @ x[columns] + own.losses(at, level).get("gain", 0.0)
    assert sum(whole.losses(point, noise).values()) == pytest.approx(losses, rel=1e-9)
    scale = np.sqrt(np.diag(hessian))
    scaled = hessian / scale / scale[:, None] + DAMPING * np.eye(len(scale))
    factor, inverse = systems.factor(DAMPING), np.linalg.inv(scaled) / scale / scale[:, None]
    assert_close(np.concatenate(factor.step(systems)) * scale, -np.linalg.solve(scaled, gradient / scale))
    determinant = np.linalg.slogdet(scaled)[1] + 2.0 * np.log(scale).sum()
    assert factor.parameter_log_determinant + sum(factor.determinants) == pytest.approx(determinant, abs=1e-6)
    # Of the last record: it has its share of what all tell of the parameters.
    bordered = BorderedFactor(factor.schur_of(whole.columns[-1]), factor.eliminated[-1].readout)
    assert_deviations(own, at, bordered, inverse[np.ix_(places, places)])
