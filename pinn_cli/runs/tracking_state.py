"""What a run's directory says of its tracked run: which one it is, and whether the tracker has everything.

Nothing slow is imported here: it is asked of every finished run of a sweep.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from pinn_cli.runs.layout import stamp
from pinn_cli.runs.reading import DamagedError, read_json
from pinn_cli.runs.writing import write_json

FILE, FORMAT = "tracking.json", 1
# The choice of the config group under which nothing is tracked.
NONE = "none"


@dataclass(frozen=True)
class TrackingState:
    """The tracked run of a run.

    Attributes:
        tracking: Name of the config group's choice.
        configuration: Digest of the run's settings (`pinn_cli.runs.identity.Identity.configuration`).
        key: What finds it again; it is written down before the tracker hears of it, so that a kill leaves no orphan.
        ended: Whether the tracker has everything of a run that has finished.
    """

    tracking: str
    configuration: str
    key: str
    ended: bool = False

    @classmethod
    def read(cls, directory: Path) -> TrackingState | None:
        """Of the run in a directory; None where nothing was tracked, or the file is damaged.

        Raises:
            InputError: A later release wrote it.
        """
        try:
            found = read_json(directory / FILE, cls, FORMAT)
        except (OSError, DamagedError):
            return None
        return found if found.key.isalnum() else None

    def write(self, directory: Path) -> None:
        """Put it into the run's directory."""
        write_json(stamp(FORMAT) | asdict(self), directory / FILE)


def is_tracked(directory: Path, config: DictConfig) -> bool:
    """Whether the tracker that a configuration asks for has everything of the finished run in a directory.

    Args:
        directory: Of the run.
        config: Composed, without its `hydra` node.
    """
    name = tracking_of(config)
    state = TrackingState.read(directory)
    return name == NONE or (state is not None and state.tracking == name and state.ended)


def tracking_of(config: DictConfig) -> str:
    """The choice of the config group, by the module that its class is in; `NONE` where there is no class."""
    target = OmegaConf.select(config, "tracking._target_")
    return NONE if target is None else str(target).rpartition(".")[0].rpartition(".")[2]


def with_class_of_today(config: DictConfig) -> DictConfig:
    """A stored configuration, whose tracking may be named as it was when its classes were in `pinn_cli.tracking`."""
    target = str(OmegaConf.select(config, "tracking._target_"))
    if target.startswith("pinn_cli.tracking."):
        today = {**config.tracking, "_target_": target.replace("pinn_cli.", "pinn_cli.sweep.", 1)}
        config.tracking = {} if tracking_of(config) == NONE else today
    return config
