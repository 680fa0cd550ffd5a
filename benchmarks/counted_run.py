"""One `pinn-run` in a process of its own, and what it took: ``python -m benchmarks.counted_run FILE OVERRIDES``.

Processor time is counted, so that other processes on the machine matter little. FILE then holds, as JSON: ``cpu_s`` of
the process and its figures, ``<stage>_cpu_s`` of every stage, ``step_<name>_cpu_s`` of every step of the method and of
what is reported of it, ``memory_mib``, ``factorisations`` with ``operations`` and ``factoring_cpu_s`` of all of them.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

from pinn_cli.main import main as pinn_run
from pinn_cli.runs.stages import Stages


class Counted:
    """What factorisations and stages take, from :meth:`watch` on."""

    def __init__(self) -> None:
        self.factorisations, self.operations, self.factoring = 0, 0.0, 0.0
        self.stages: dict[str, float] = {}

    def watch(self) -> None:
        """Have every factorisation, every stage and every step counted."""
        from pinn_cli.training import gauss_newton, inference
        from pinn_cli.training.normal_matrix.bordered import BorderedSystem
        from pinn_cli.training.reported import stories

        inference.STEPS = tuple((self._step(step), rounds) for step, rounds in inference.STEPS)
        for place, name in (
            (inference, "identify_by_spectra"), (inference, "first_solution"), (gauss_newton, "posterior_estimate"),
            (gauss_newton, "parameter_likelihoods"), (stories, "doubts"),
        ):  # fmt: skip
            setattr(place, name, self._step(getattr(place, name)))
        self.stages["before"] = time.process_time()

        eliminated, stage = BorderedSystem.eliminated, Stages.__call__

        def timed(system: BorderedSystem, damping: float = 0.0) -> Any:
            began = time.process_time()
            found = eliminated(system, damping)
            self.factoring += time.process_time() - began
            self.factorisations += 1
            self.operations += 0.0 if found is None else found.readout.operations
            return found

        @contextmanager
        def in_stage(stages: Stages, name: str) -> Iterator[None]:
            began = time.process_time()
            with stage(stages, name):
                yield
            self.stages[name] = self.stages.get(name, 0.0) + time.process_time() - began

        BorderedSystem.eliminated = timed  # type: ignore[method-assign]
        Stages.__call__ = in_stage  # type: ignore[method-assign, assignment]

    def _step(self, step: Callable[..., Any]) -> Callable[..., Any]:
        name = f"step_{step.__name__}"

        @wraps(step)
        def timed(*given: Any) -> Any:
            began = time.process_time()
            try:
                return step(*given)
            finally:
                self.stages[name] = self.stages.get(name, 0.0) + time.process_time() - began

        return timed

    def record(self) -> dict[str, float]:
        """All of it, by name."""
        own, drawn = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
        return {
            "cpu_s": own.ru_utime + own.ru_stime + drawn.ru_utime + drawn.ru_stime,
            **{f"{name}_cpu_s": seconds for name, seconds in self.stages.items()},
            "memory_mib": own.ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10),
            "factorisations": self.factorisations,
            "operations": self.operations,
            "factoring_cpu_s": self.factoring,
        }


def main() -> None:
    """Run, and write what it took; exits as `pinn-run` does."""
    place, sys.argv = Path(sys.argv[1]), ["pinn-run", *sys.argv[2:]]
    counted = Counted()
    counted.watch()
    try:
        pinn_run()
    finally:
        place.write_text(json.dumps(counted.record()))


if __name__ == "__main__":
    main()
