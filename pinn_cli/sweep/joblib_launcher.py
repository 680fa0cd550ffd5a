"""`hydra/launcher=joblib`: Hydra's plugin, but a worker that is killed takes only its own job along."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from hydra.core.utils import JobReturn
from hydra_plugins.hydra_joblib_launcher import joblib_launcher as plugin
from joblib.externals.loky.process_executor import BrokenProcessPool

from pinn_cli.sweep.launched import Launched

_REASON = "its worker was killed, again when it ran alone: by the system for want of memory, perhaps"


class JoblibLauncher(plugin.JoblibLauncher):
    """See the module."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run all jobs. When a worker is killed, joblib ends all: the others go on, then those that it may have been.

        Args:
            job_overrides: Of each job.
            initial_job_idx: Number of the first.

        Returns:
            What each job returned, in the same order; NaN for one that was lost.
        """
        jobs = [Launched(self, list(overrides), initial_job_idx + n) for n, overrides in enumerate(job_overrides)]
        suspects: list[Launched] = []
        returns: dict[int, JobReturn] = {}
        while len(returns) + len(suspects) < len(jobs):
            left = [job for job in jobs if job not in suspects]
            began = time.time()
            try:
                returns = self._run(left)
            except BrokenProcessPool:
                under_way = [job for job in left if job.under_way_since(began)]
                if not under_way:  # workers do not even start
                    raise
                print(f"a worker was killed: {len(under_way)} jobs are put off, to run alone", file=sys.stderr)
                suspects += under_way
        for job in suspects:
            returns |= self._run_alone(job)
        return [returns[number] for number in sorted(returns)]

    def _run_alone(self, job: Launched) -> dict[int, JobReturn]:
        try:
            return self._run([job])
        except BrokenProcessPool:
            return {job.number: job.lost(_REASON)}

    def _run(self, jobs: Sequence[Launched]) -> dict[int, JobReturn]:
        if not jobs:
            return {}
        returned = super().launch([job.overrides for job in jobs], jobs[0].number)
        return dict(zip((job.number for job in jobs), returned, strict=True))
