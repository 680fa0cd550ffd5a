"""The most probable parameters of a linear structure under unknown forces, by Whittle's likelihood.

Forces that nobody measured leave the motion open: what tells the parameters is how probable the sensors' spectra are
with all motions and forces integrated out,

    -log p = sum over frequencies of [log det S + tr(S^-1 P)] + priors

(Whittle, Arkiv foer Matematik 2, 1953; Au, Operational Modal Analysis, 2017, has it for single modes). The most
probable motion, forces and parameters together are something else: their damping is far too small.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.linalg import cho_factor, cho_solve
from scipy.special import chdtrc

from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.modal_fit import IMPROBABLE_PART
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.doubts.other_damping import DampingDoubt, damping_doubt, with_other_damping
from pinn_cli.training.noise_model import updated_spread
from pinn_cli.training.whittle.spectral_model import ExpectedSpectra, SpectralModel, is_spectral, spectra_in_band

# Steps of Fisher scoring at most, and the decrease of -log p below which nothing is gained.
WHITTLE_STEPS, NEGLIGIBLE_DECREASE = 60, 1e-3
# Most that a logarithm may change in one step.
LARGEST_STEP = 2.0
# Damping of a step, relative to the diagonal of the information: first, largest.
FIRST_FISHER_DAMPING, LARGEST_FISHER_DAMPING = 1e-4, 1e4
# Rounds of the prior spreads; what those of the forces' spectrum and of differences between forces are believed to be,
# nepers, as if one bend, and one difference, of that size had been seen: two forces whose difference a record does not
# tell look alike, and would be taken for it.
PRIOR_ROUNDS, USUAL_SPREAD, PRIOR_SETTLED = 12, 0.3, 0.05
# Parts of the spectra that a misfit is looked for in, as wide as a resonance and its flanks, and values in one at the
# least.
PART_RATIO, FEWEST_IN_PART = 1.1, 20.0
# Of what leaks out of resonances in a usual record, so much may have leaked out of this one.
LEAKED_SHARES = 0.0, 0.03, 0.1, 0.3, 1.0
# Prior standard deviation of the logarithm of a sensor's noise about what its spectrum shows.
NOISE_SPREAD = 3.0


@dataclass(frozen=True, eq=False)
class KnownParameters:
    """What the spectra tell of the parameters of a problem.

    Attributes:
        distance: (p,), from the prescribed values in prior standard deviations.
        covariance: (p, p), of those.
        log_likelihood: Of the record, with its priors.
        converged: Whether another step would change nothing.
        misfit: How many times the power of the part of the spectra that fits worst is off; see :meth:`Whittle.misfit`.
        spread: How far believed parameters are off in common, over what was believed.
        damping_doubt: What the spectra say of another model of damping; None where that was not asked.
    """

    distance: np.ndarray
    covariance: np.ndarray
    log_likelihood: float
    converged: bool
    misfit: float
    spread: float
    damping_doubt: DampingDoubt | None = None


@dataclass(frozen=True, eq=False)
class Scored:
    """-log p at some unknowns, its gradient (q,) and its expected Hessian (q, q), the priors' parts included."""

    value: float
    gradient: np.ndarray
    information: np.ndarray


class Whittle:
    """Whittle's likelihood of a model, with Gaussian priors of its unknowns.

    Args:
        model: Of the spectra.
        learn_spread: Whether believed parameters may be off by more than was believed, in common. By less they never
            are: few of them look right by chance, and their intervals came out too narrow.
    """

    def __init__(self, model: SpectralModel, learn_spread: bool) -> None:
        self.model, self.spectrum, self.learn_spread = model, model.spectrum, learn_spread
        lower, self.believed = model.vector.each("lower") / model.spread, ~model.vector.each("unknown").astype(bool)
        self.lower = np.full(model.size, -np.inf)
        self.lower[model.places["parameters"]] = lower
        self.lower[model.places["together"]] = 0.0
        self.centre, self.has_centre, self.leaked = model.start(), np.zeros(model.size), np.zeros((1, 1, 1))
        self.has_centre[model.places["noise"]] = 1.0
        knots = model.shape.shape[1]
        self.bends = np.zeros((max(knots - 2, 0), model.size))
        self.bends[:, model.places["shape"]] = np.diff(np.eye(knots), 2, axis=0)
        self.differences = np.zeros((model.unknown_forces, model.size))
        self.differences[:, model.places["forces"]] = np.eye(model.unknown_forces)

    def precision(self, spreads: np.ndarray) -> np.ndarray:
        """(q, q), of the priors.

        Args:
            spreads: (3,), of the bends of the forces' spectrum, of what forces differ by, and of what believed
                parameters are off by in common, over what was believed.
        """
        diagonal = np.zeros(self.model.size)
        diagonal[self.model.places["parameters"]] = np.where(self.believed, spreads[2] ** -2, 1.0)
        diagonal[self.model.places["noise"]] = NOISE_SPREAD**-2
        diagonal[self.model.places["together"]] = 1.0
        out, prior, places = np.diag(diagonal), self.model.problem.prior, self.model.places["parameters"]
        if prior is not None:
            out[places, places] = prior.precision * np.sqrt(np.outer(diagonal[places], diagonal[places]))
        for rows, spread in zip((self.bends, self.differences), spreads[:2], strict=True):
            out += rows.T @ rows / spread**2
        return out

    def scored(self, x: np.ndarray, precision: np.ndarray) -> Scored | None:
        """At unknowns (q,); None where the covariance is not positive definite."""
        (covariance, slopes, seen, seen_slopes), count = self.model.covariance(x), self.spectrum.count
        try:
            root = np.linalg.cholesky(covariance + self.leaked)
        except np.linalg.LinAlgError:
            return None
        residual, crossed = self._residual_spectra(seen)
        # All that follows is in units in which S is the identity, as the power is then on average.
        unit = np.linalg.inv(root)
        hermitian = unit.conj().transpose(0, 2, 1)
        power, crossed = unit @ residual @ hermitian, crossed @ hermitian
        slopes, seen = unit @ slopes @ hermitian, unit @ seen_slopes
        log_determinant = 2.0 * np.log(np.einsum("gss->gs", root).real).sum(1)
        away = x - self.centre * self.has_centre
        prior = 0.5 * float(away @ precision @ away)
        value = float(count @ (log_determinant + np.einsum("gss->g", power).real)) + prior
        excess = (np.eye(power.shape[-1]) - power) * count[:, None, None]
        gradient = np.einsum("qgst,gts->q", slopes, excess, optimize=True).real + precision @ away
        flat = (slopes * np.sqrt(count)[:, None, None]).reshape(len(x), -1)
        information = (flat @ flat.conj().T).real + precision
        p = len(seen)
        if seen.shape[-1]:  # of measured forces
            loads = self.spectrum.of_acting * count[:, None, None]
            gradient[:p] += 2.0 * np.einsum("g,pgsl,gls->p", count, seen, crossed, optimize=True).real
            products = np.einsum("pgsl,glm,qgsm->pq", seen, loads, seen.conj(), optimize=True).real
            information[:p, :p] += 2.0 * products
        return Scored(value, gradient, information)

    @cached_property
    def _expected(self) -> ExpectedSpectra:
        return ExpectedSpectra(self.model)

    def allow_for_leakage(self, x: np.ndarray) -> None:
        """From here on lines hold what resonances leak into them at the unknowns (q,): else it passes for noise.

        What a resonance loses is as it would be in a longer record: it hangs on the damping that is looked for.
        """
        more = self._expected(self.model, x) - self.model.power(x)[0]
        size = np.sqrt(self.spectrum.power[:, : more.shape[1]])
        unit = size[:, :, None] * size[:, None]
        values, vectors = np.linalg.eigh(more / unit)
        self.leaked = unit * ((vectors * np.maximum(values, 0.0)[:, None]) @ vectors.conj().transpose(0, 2, 1))

    def _residual_spectra(self, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(G, S, S), what measured forces leave of the responses, which see so much (G, S, L) of them; (G, L, S)."""
        sensors = seen.shape[1]
        responses, loads = self.spectrum.cross[:, :sensors, :sensors], self.spectrum.of_acting
        cross, back = self.spectrum.cross[:, sensors:, :sensors], seen.conj().transpose(0, 2, 1)
        residual = responses - seen @ cross - cross.conj().transpose(0, 2, 1) @ back + seen @ loads @ back
        return residual, loads @ back - cross

    def updated(self, spreads: np.ndarray, x: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """(3,), the most probable spreads of :meth:`precision` at a solution."""
        pairs = zip((self.bends, self.differences), spreads[:2], strict=True)
        of_forces = [_spread(rows, x, covariance, spread) for rows, spread in pairs]
        believed = np.flatnonzero(self.believed)
        if not self.learn_spread or not len(believed):
            return np.array([*of_forces, spreads[2]])
        spread = updated_spread(x[believed], np.diag(covariance)[believed], spreads[2])
        return np.array([*of_forces, max(1.0, spread)])

    def maximised(self, x: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, Scored, bool] | None:
        """The most probable unknowns by Fisher scoring with Levenberg's damping, and whether they are converged."""
        scored, damping = self.scored(x, precision), FIRST_FISHER_DAMPING
        if scored is None:
            return None
        for _ in range(WHITTLE_STEPS):
            held = (x <= self.lower) & (scored.gradient > 0.0)
            while True:
                moved = np.maximum(x + self._limited(_step(scored, damping, held)), self.lower)
                trial = self.scored(moved, precision)
                if trial is not None and trial.value <= scored.value + NEGLIGIBLE_DECREASE:
                    break
                damping *= 10.0
                if damping > LARGEST_FISHER_DAMPING:
                    return x, scored, False
            decrease, x, scored = scored.value - trial.value, moved, trial
            damping = max(damping / 10.0, 1e-12)
            if decrease < NEGLIGIBLE_DECREASE and damping < 1.0:
                return x, scored, True
        return x, scored, False

    def _limited(self, step: np.ndarray) -> np.ndarray:
        """A step that changes no logarithm by more than a factor of about ten."""
        logarithms = np.r_[self.model.places["shape"].start : self.model.size]
        return step * min(1.0, LARGEST_STEP / max(float(np.abs(step[logarithms]).max()), 1e-300))

    def misfit(self, x: np.ndarray) -> float:
        """See :attr:`KnownParameters.misfit`: where the sensors' whitened spectra are no unit matrix beyond chance.

        What leaks out of resonances into the lines hangs on how the record began and how it ends, two states of a
        motion: what is off for any part of the usual leak is. Of a record from rest to rest there is none.
        """
        plain, seen = self.model.power(x)
        residual, _ = self._residual_spectra(seen)
        leak = self._expected(self.model, x) - plain
        try:
            np.linalg.cholesky(plain + leak)
        except np.linalg.LinAlgError:  # what a measured force leaks is a difference, which rounding may turn
            leak = self.leaked
        units = (np.linalg.inv(np.linalg.cholesky(plain + share * leak)) for share in LEAKED_SHARES)
        return float(np.min([self._misfit_by_part(unit, residual) for unit in units], axis=0).max(initial=0.0))

    def _misfit_by_part(self, unit: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """How far the spectra (G, S, S), whitened by the unit (G, S, S), are off in each part; 0 where by chance."""
        power, count = unit @ residual @ unit.conj().transpose(0, 2, 1), self.spectrum.count
        part = np.floor(np.log(self.spectrum.omega / self.spectrum.omega[0]) / np.log(PART_RATIO)).astype(int)
        found, size = np.zeros(part[-1] + 1), power.shape[-1]
        for number in range(len(found)):
            lines = part == number
            values = count[lines].sum()
            if values < FEWEST_IN_PART:
                continue
            off = np.einsum("g,gst->st", count[lines], power[lines]) / values - np.eye(size)
            by_chance = chdtrc(size**2, values * np.sum(np.abs(off) ** 2)) * len(found)
            if by_chance < IMPROBABLE_PART:
                found[number] = np.linalg.norm(off, 2)
        return found


def known_parameters(whole: JointProblem, learn_spread: bool = True) -> KnownParameters | None:
    """What the spectra of a record tell of a problem's parameters; None where they are not all that it tells.

    Of ``learn_spread`` see :class:`Whittle`.
    """
    if len(whole) > 1:  # they have no spectra together
        return None
    problem = whole.alone
    if problem.spectral is not None:  # what somebody else has found already
        spectral, unit = problem.spectral, np.array([parameter.prior_std for parameter in problem.uncertain])
        covariance = spectral.covariance / np.outer(unit, unit)
        return KnownParameters(np.zeros(len(unit)), covariance, spectral.log_likelihood, True, spectral.misfit, 1.0)
    # What a measured force does at the ends of a record leaks: beside it held parameters would be doubted for nothing.
    if not is_spectral(problem) or (not problem.uncertain and problem.record.sensors(FORCE).any()):
        return None
    spectrum = spectra_in_band(problem.record)
    if spectrum is None:
        return None
    model = SpectralModel(problem, spectrum)
    whittle = Whittle(model, learn_spread)
    x, spreads = whittle.centre, np.array([USUAL_SPREAD, USUAL_SPREAD, 1.0])
    for round_ in range(PRIOR_ROUNDS):
        if round_:
            whittle.allow_for_leakage(x)
        maximum = whittle.maximised(x, whittle.precision(spreads))
        if maximum is None:
            return None
        x, scored, converged = maximum
        model.follow_modes(x)
        covariance, before = np.linalg.inv(scored.information), spreads
        spreads = whittle.updated(spreads, x, covariance)
        if round_ and np.abs(np.log(spreads / before)).max() < PRIOR_SETTLED:
            break
    places = model.places["parameters"]
    misfit, doubt = whittle.misfit(x), _scored_damping(whittle, x, before)
    return KnownParameters(
        x[places], covariance[places, places], -scored.value, converged, misfit, float(before[2]), doubt
    )


def _scored_damping(whittle: Whittle, x: np.ndarray, spreads: np.ndarray) -> DampingDoubt | None:
    """See `other_damping`: the most probable unknowns beside the solution (q,), which a step alone does not reach."""
    model = whittle.model
    p, problem = len(model.spread), model.problem
    values = model.vector.values(torch.as_tensor(x[:p] * model.spread))
    extended = with_other_damping(problem, {kind: value.numpy() for kind, value in values.items()})
    if extended is None:
        return None
    more = Whittle(SpectralModel(extended, model.spectrum), whittle.learn_spread)
    new = len(more.model.spread) - p
    start = np.concatenate((x[:p], np.zeros(new), x[p:]))
    more.leaked = whittle.leaked
    more.centre = np.concatenate((whittle.centre[:p], np.zeros(new), whittle.centre[p:]))
    maximum, without = more.maximised(start, more.precision(spreads)), whittle.scored(x, whittle.precision(spreads))
    if maximum is None or without is None:
        return None
    moved, scored, _ = maximum
    volume = np.linalg.slogdet(without.information)[1] - np.linalg.slogdet(scored.information)[1]
    log_odds = without.value - scored.value + 0.5 * float(volume)
    distances = start[: p + new] * more.model.spread, moved[: p + new] * more.model.spread
    return damping_doubt(problem, extended, distances, log_odds)


def _step(scored: Scored, damping: float, held: np.ndarray) -> np.ndarray:
    """A damped step (q,) of Fisher scoring; the unknowns that are held at a bound stay there."""
    free, step = ~held, np.zeros(len(held))
    information = scored.information[np.ix_(free, free)]
    information = information + damping * np.diag(np.diag(information))
    step[free] = -cho_solve(cho_factor(information), scored.gradient[free])
    return step


def _spread(rows: np.ndarray, x: np.ndarray, covariance: np.ndarray, before: float) -> float:
    """The most probable prior spread of some sums of unknowns (MacKay 1992), beside what is usual."""
    if not len(rows):
        return before
    determined = len(rows) - np.trace(rows @ covariance @ rows.T) / before**2
    spread = np.sqrt((np.sum((rows @ x) ** 2) + USUAL_SPREAD**2) / (max(determined, 0.0) + 1.0))
    return float(np.clip(spread, 0.2 * before, 5.0 * before))
