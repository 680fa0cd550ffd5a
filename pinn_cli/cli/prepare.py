"""From settings to a problem that is ready to be solved: what every command does before it estimates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hydra.types import RunMode
from omegaconf import DictConfig, open_dict

from pinn_cli.cli.composing import CONFIG, checked_hydra, in_folders
from pinn_cli.runs.stages import Stages

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.cli.config import RunConfig
    from pinn_cli.record.record import Record, Truth
    from pinn_cli.record.validation_data import ValidationRecord
    from pinn_cli.scheme.joint_problem import JointProblem
    from pinn_cli.system.structure import Structure


@dataclass(frozen=True, eq=False)
class PreparedProblem:
    """What an estimator is given, and what it is scored against.

    Attributes:
        true: The system that a simulated record comes from.
        prescribed: The model that the estimator is given.
        record: What it may see; of several records the first.
        truth: What it is scored against, and nothing else; of several records that of the first.
        problem: What it solves.
        truths: Of every record.
        validation: What the identified system is tried on, of which no estimator is told; None: nothing.
    """

    true: Structure
    prescribed: Structure
    record: Record
    truth: Truth
    problem: JointProblem
    truths: tuple[Truth, ...]
    validation: ValidationRecord | None = None


def prepare_problem(config: RunConfig, stages: Stages | None = None) -> PreparedProblem:
    """Simulate or read the record and set up the problem.

    Args:
        config: Of the run.
        stages: The seconds of ``system``, ``record`` and ``problem`` are added to it.

    Raises:
        InputError: A setting or a file that no run can use.
    """
    from pinn_cli.scheme.modal.modal_problem import modal_problem
    from pinn_cli.scheme.reach import tell_if_unreached

    stages = stages or Stages()
    with stages("system"):
        true, prescribed = config.model_error.structures(config.structure)
        prescribed = prescribed if config.model is None else config.model.structure
    with stages("record"):
        measurements = config.source.measurements(true)
        records = [config.observe(each.record) for each in measurements]
        validate = config.source.validate
        validation = None if validate is None else validate(true, records)
    with stages("problem"):
        if config.modes is None:
            prescribed = config.scheme.damped(prescribed, records)
            problem = config.scheme.pose(prescribed, records)
        else:
            problem = modal_problem(config.modes, prescribed, records)
            prescribed = problem.structure
        tell_if_unreached(problem)
    truths = tuple(each.truth for each in measurements)
    return PreparedProblem(true, prescribed, records[0], truths[0], problem, truths, validation)


def compose_config(overrides: Sequence[str], config_dir: str | None = None) -> DictConfig:
    """The configuration of ``pinn-run <overrides>``, without a process or a directory of its own.

    Args:
        overrides: As typed.
        config_dir: A folder of more configurations.

    Raises:
        hydra.errors.HydraException: The overrides do not compose.
        InputError: They choose a class that is not registered.
    """
    with checked_hydra() as loader:
        config = loader.load_configuration(CONFIG, in_folders(overrides, config_dir), RunMode.RUN, from_shell=False)
    with open_dict(config):
        del config["hydra"]
    return config
