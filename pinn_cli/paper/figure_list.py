"""The paper's Figures 1 to 14: what each shows, and the run that it is drawn from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper.

    Attributes:
        number: In the paper.
        kind: ``chain``, ``framework``, ``domains``, ``response``, ``error_map`` or ``pairs``.
        title: A few words, for headings and alternative text.
        caption: Sentences in our own words.
        run: Name of the run that it is drawn from; empty where it is drawn from none.
    """

    number: int
    kind: str
    title: str
    caption: str
    run: str = ""

    @property
    def name(self) -> str:
        """Of its files."""
        return f"figure{self.number:02d}"

    @property
    def case(self) -> str:
        """Of the run."""
        return self.run.rpartition("_")[0]


_LINES = (
    " Rows are DOFs, an asterisk marks those without a response sensor; columns are displacement, velocity, "
    "acceleration "
    "and force. Black: the truth; red dashes: our estimate with its 95 % band; green dots: the Kalman smoother."
)
_PAIRS = (
    " On the diagonal each parameter's marginal posterior, dark within its 90 % interval; below it the joint density "
    "of "
    "each pair; above it their correlation. Dashed lines mark the true values."
)
PAPER_FIGURES = (
    PaperFigure(
        1, "chain", "The chain of masses",
        "The chain. Mass i is tied to its neighbour nearer the fixed end by a damper, a spring and a nonlinear element "
        "(Duffing or Van der Pol); forces may act on every mass, in the paper's cases on the first one only.",
    ),
    PaperFigure(
        2, "framework", "The framework of a physics-informed neural network",
        "How the estimate is found. The network gives the motion as a function of time. Sensors pull it towards the "
        "data "
        "(above, observation domain); the equation of motion, with prescribed, uncertain or unknown parameters, pulls "
        "it "
        "towards the physics (below, collocation domain). Both residuals, weighted by their noise levels, drive the "
        "network's weights and the system's parameters together.",
    ),
    PaperFigure(
        3, "domains", "Observation and collocation domains",
        "Where there are data and where physics is enforced, in time and over DOFs, for a forward solution, sparse "
        "recovery beyond the sensors, state-parameter estimation between the sensors, and Bayesian estimation of "
        "parameters with every state observed. Shaded: collocation domain; dots: observations.",
    ),
    PaperFigure(
        4, "response", "Sparse recovery, 6 DOFs",
        "Sparse recovery of the 6-DOF Duffing chain with the right model at 50 dB." + _LINES, "sr_6dof_snr50_uncertain",
    ),
    PaperFigure(
        5, "response", "Sparse recovery, 20 DOFs",
        "Sparse recovery of the 20-DOF Duffing chain at 50 dB; the first two and the last two DOFs are shown." + _LINES,
        "sr_20dof_snr50_uncertain",
    ),
    PaperFigure(
        6, "error_map", "Absolute error, 20 DOFs",
        "Absolute error of our estimate of the 20-DOF chain over time and DOFs; the dashed red frame holds the DOFs "
        "with "
        "a sensor.", "sr_20dof_snr50_uncertain",
    ),
    PaperFigure(
        7, "response", "Sparse recovery with a linear model",
        "Sparse recovery of the 6-DOF Duffing chain by an estimator that is given a linear model. Blue dash-dots: the "
        "true response of the equivalent linear chain under the same force." + _LINES, "sr_6dof_linear_uncertain",
    ),
    PaperFigure(
        8, "response", "Sparse recovery with wrong values",
        "Sparse recovery of the 6-DOF Duffing chain by an estimator whose prescribed parameters are 5 to 10 % off."
        + _LINES, "sr_6dof_perturbed_uncertain",
    ),
    PaperFigure(
        9, "response", "State-parameter estimation, Duffing",
        "State-parameter estimation of the 5-DOF Duffing chain at 50 dB; DOFs 2 and 4 have no sensor, and stiffness "
        "and "
        "nonlinearity of connections 2 and 4 are unknown." + _LINES, "sp_5dof_snr50_uncertain",
    ),
    PaperFigure(
        10, "response", "State-parameter estimation, Van der Pol",
        "The same of the 5-DOF Van der Pol chain." + _LINES, "sp_5dof_van_der_pol_uncertain",
    ),
    PaperFigure(
        11, "response", "State-parameter estimation with a linear model",
        "State-parameter estimation of the 5-DOF Duffing chain by an estimator that is given a linear model. Blue "
        "dash-dots: the true response of the equivalent linear chain." + _LINES, "sp_5dof_linear_uncertain",
    ),
    PaperFigure(
        12, "response", "State-parameter estimation with wrong values",
        "State-parameter estimation of the 5-DOF Duffing chain by an estimator whose other parameters are 5 to 10 % "
        "off."
        + _LINES, "sp_5dof_perturbed_uncertain",
    ),
    PaperFigure(
        13, "pairs", "Posterior of the Duffing chain",
        "Posterior of all parameters of the 2-DOF Duffing chain, the states uncertain (marginal posterior)." + _PAIRS,
        "pe_2dof_duffing_marginal",
    ),
    PaperFigure(
        14, "pairs", "Posterior of the Van der Pol chain",
        "Posterior of all parameters of the 2-DOF Van der Pol chain, the states uncertain (marginal posterior)."
        + _PAIRS, "pe_2dof_van_der_pol_marginal",
    ),
)  # fmt: skip
