"""The method: from a problem to its most probable solution under the most probable noise levels.

The unknowns are the weights W of a network of time and the parameters theta. A problem is a list of factors
(:mod:`pinn_cli.training.factors`), so the loss is one weighted sum of squares, -log p(record, W, theta | levels): each
weight is 1 / sigma^2 of a noise level. A damped Gauss-Newton step solves its normal equations
(:mod:`pinn_cli.training.minimise`); their inverse is the covariance of W and theta. With W and theta integrated out the
levels have an evidence (:mod:`pinn_cli.training.evidence`; MacKay 1992), by which they are found:

1. **Spectra first.** Forces that nobody measured leave the motion open: Whittle's likelihood of the sensors' spectra
   tells the parameters of a linear structure, and they are held. Those of another one are held from the first solution
   to where what is integrated out moves them.
2. **Soft to stiff.** From one start of the parameters after the other, until a model holds, the discrepancy, a force
   that stands for what the model leaves out, comes down from the force that acts to its most probable level; each
   solution begins at the last. Then all levels follow sigma^2 <- |r|^2 / (N - gamma).
3. **The problem is posed again** as its solution asks for (`STEPS`): forces in their own band and colour, damping in
   its own modes, contacts apart from where they turn, features fine enough. The solution is carried over each time.
4. **What the levels do not say:** which of several structures is meant, which discrepancy all windows agree on, how
   many independent values a coloured discrepancy has, which parameters are most probable with the motion integrated
   out, and what they would be if the structure ran free, or if the force that the model leaves out were smooth.

What is reported of the solution is :mod:`pinn_cli.training.reported`, what the model may lack
:mod:`pinn_cli.training.doubts`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.training.solver import Inference, Solver
from pinn_cli.training.steps.first_solution import first_solution, identify_by_spectra
from pinn_cli.training.steps.free_running import fit_free_run
from pinn_cli.training.steps.marginal_peak import move_to_marginal_peak
from pinn_cli.training.steps.quiet_load_cells import quiet_load_cells
from pinn_cli.training.steps.rivals import choose_equivalent_structure
from pinn_cli.training.steps.smooth_force import fit_smooth_force
from pinn_cli.training.steps.unknown_forces import fit_force_spectrum, set_force_level, widen_force_band
from pinn_cli.training.steps.updated_problem import (
    loosen_at_turning_points,
    lower_discrepancy,
    place_knots,
    refine_features,
    update_modes,
)
from pinn_cli.training.steps.windows_discrepancy import combine_windows, count_independent_values

# From a solution to a better one; None: there is none. Each is asked so many times at most.
Step = Callable[[Inference], Inference | None]
STEPS: tuple[tuple[Step, int], ...] = (
    (widen_force_band, 1),
    (fit_force_spectrum, 3),
    (update_modes, 3),
    (place_knots, 6),
    (loosen_at_turning_points, 6),
    (refine_features, 2),
    (place_knots, 3),
    (lower_discrepancy, 6),
    (update_modes, 3),
    (choose_equivalent_structure, 1),
    (quiet_load_cells, 1),
    (combine_windows, 1),
    (count_independent_values, 1),
    (set_force_level, 2),
    (move_to_marginal_peak, 12),
    (fit_free_run, 1),
    (fit_smooth_force, 1),
)
# Where a finished run says where the solution is, steps from there converge at once: then this ends them.
NEAR_TOLERANCE = 3e-5


def infer(problem: JointProblem, solver: Solver) -> Inference:
    """The most probable readout and parameters under the most probable noise levels.

    Raises:
        DivergenceError: Even the softest physics cannot be solved.
    """
    problem, solver = identify_by_spectra(problem, solver)
    inference = first_solution(problem, _as_believed(problem, solver))
    for step, rounds in STEPS:
        for _ in range(rounds):
            better = step(inference)
            if better is None:
                break
            inference = better
    return inference


def _as_believed(problem: JointProblem, solver: Solver) -> Solver:
    """The common spread of the parameters is learned where they are beliefs of a user that measured forces contradict.

    What earlier records leave open is no such belief, and forces that nobody measured follow wrong parameters: together
    with the most probable of them these move, the spread after them, and so on.
    """
    if problem.is_informed:
        solver = replace(solver, tolerance=max(solver.tolerance, NEAR_TOLERANCE))
    is_followed = any(record_problem.inputs.unmeasured for record_problem in problem)
    return replace(solver, learn_spread=False) if is_followed or problem.is_informed else solver
