"""Small problems of Bayesian parameter estimation, and what training makes of them."""

from dataclasses import dataclass

from one_record import evidence_of, levels_of, shown_noise
from small_problems import excitation

from pinn_cli.network.spline import Spline
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.structure import Structure
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.levels import settled
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.training.steps.discrepancy_search import searched
from pinn_cli.training.steps.windows_discrepancy import widened

PRECISE = 1e-10  # relative decrease of the loss below which a solution counts as the most probable one


@dataclass(frozen=True, eq=False)
class Example:
    """A problem and the most probable network of it."""

    problem: Problem
    evidence: Evidence
    trained: Trained

    @property
    def equations(self) -> NormalEquations:
        return self.evidence.equations.by_record[0]


def source(
    chain: Structure,
    *,
    forced: tuple[int, ...] = (1,),
    duration: float = 12.0,
    samples: int = 257,
    snr_db: float = 20.0,
    repeats: int = 1,
    hold: str = "exact",
    seed: int = 0,
    rms: float = 4.0,
) -> Simulated:
    """A force of the given rms, N, in a band about that of the chain, and noise on every sensor."""
    band = excitation(chain, duration, samples).band
    force = BandedNoise(chain.ndof, duration, samples, list(band), rms, list(forced))
    return Simulated(force, Simulation(duration, samples, hold), Noise(snr_db, seed, repeats=repeats))


def posed(chain: Structure, scheme: Bayesian | None = None, **settings) -> Problem:
    """The problem of a simulated record, of whose chain the scheme knows the masses only; see :func:`source`."""
    scheme = scheme or Bayesian()
    return scheme.pose(chain, [scheme.observe(source(chain, **settings).measure(chain).record)]).alone


def solved(problem: Problem, intervals: int | None = None) -> Example:
    """As training=gauss_newton solves it, only to the last digit."""
    network = Spline(intervals=intervals).refined().build(problem.record)
    evidence = evidence_of(NormalEquations(network, problem), 40, PRECISE)
    force, _ = force_and_velocity_scale(problem)
    noise = levels_of(shown_noise(problem.record, force, 1.0))
    found = settled(evidence, searched(evidence, noise, lambda: None))
    return Example(problem, evidence, widened(evidence, found))
