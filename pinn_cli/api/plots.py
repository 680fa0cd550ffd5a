"""The figures of a finished run, drawn when they are asked for: as the run itself draws them."""

from __future__ import annotations

from functools import cached_property, partial
from io import BytesIO
from typing import TYPE_CHECKING

from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

    from pinn_cli.api.run_files import RunFiles


class Plots:
    """``result.plot``: each method returns a matplotlib figure, which a notebook shows.

    Args:
        result: Whose figures they are; of several records solved together those of the first.
    """

    def __init__(self, result: RunFiles) -> None:
        self._result = result

    @cached_property
    def _builders(self) -> dict[str, Callable[[], Figure]]:
        from pinn_cli.api.stored import stored_results
        from pinn_cli.report.figures import record_drawings, run_drawings
        from pinn_cli.report.figures.posterior import posterior_pairs_figure

        results, place = stored_results(self._result), self._result.directory
        drawings = [*record_drawings(results, place), *run_drawings(results, place)]
        found: dict[str, Callable[[], Figure]] = {drawing.name: drawing.build for drawing in drawings}
        if self._result.posterior is not None:
            draws = self._result.posterior["posterior"]
            parameters = [estimate.parameter for estimate in results.estimate.parameters]
            found["posterior"] = partial(posterior_pairs_figure, draws, parameters, results.truth.parameters)
        return found

    @property
    def names(self) -> list[str]:
        """Those that the run has something for."""
        return list(self._builders)

    def response(self) -> Figure:
        """Estimated response with 95 % bands, measurements, and the truth where it is known, DOF by DOF."""
        return self._drawn("response")

    def residuals(self) -> Figure:
        """What the estimate leaves of every sensor: over time, frequency and lag."""
        return self._drawn("residuals")

    def error_map(self) -> Figure:
        """Error, or standard deviation where there is no truth, over time and DOF."""
        return self._drawn("error_map")

    def drift(self) -> Figure:
        """How far every connection is stretched."""
        return self._drawn("drift")

    def hysteresis(self) -> Figure:
        """Loops of connections that have memory."""
        return self._drawn("hysteresis")

    def parameters(self) -> Figure:
        """Parameters with 90 % intervals."""
        return self._drawn("parameters")

    def correlation(self) -> Figure:
        """Which parameters the record cannot tell apart."""
        return self._drawn("correlation")

    def modes(self) -> Figure:
        """Mode shapes with frequencies and damping ratios."""
        return self._drawn("modes")

    def structure(self) -> Figure:
        """Masses and connections of a structure that is no chain."""
        return self._drawn("structure")

    def history(self) -> Figure:
        """Loss terms and weights over the iterations."""
        return self._drawn("history")

    def posterior(self) -> Figure:
        """Distributions of the parameters, with ``scheme=bayesian``."""
        return self._drawn("posterior")

    def _drawn(self, name: str) -> Figure:
        if name not in self._builders:
            raise InputError(f"plot.{name}", "()", f"one of {', '.join(self.names)}", "the run has nothing for it")
        figure = self._builders[name]()
        # Figures that pyplot has not made are shown by no notebook of their own accord.
        figure._repr_png_ = partial(_png, figure)  # type: ignore[attr-defined]
        return figure


def _png(figure: Figure) -> bytes:
    from pinn_cli.report.figures.style import look

    content = BytesIO()
    with look():
        figure.savefig(content, format="png")
    return content.getvalue()
