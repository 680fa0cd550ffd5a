"""Words of the command line that ask for something else than a run: `inspect`, `follow`."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import dataclass

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of


@dataclass(frozen=True)
class Subcommand:
    """A word among the overrides.

    Attributes:
        word: It.
        left_out: Settings that go ill with it.
        one_at_a_time: Why there is no sweep of it.
        hint: What to do instead of giving one of those settings.
        directory: Override of the run's directory, unless the command line has one; "": none.
    """

    word: str
    left_out: tuple[str, ...]
    one_at_a_time: str
    hint: str = ""
    directory: str = ""

    def taken_out(self, options: Namespace) -> bool:
        """Whether the command line says it; the word is taken out of it, and what goes ill with it is refused.

        Args:
            options: As read, changed in place.

        Raises:
            InputError: Something else is asked for along with it.
        """
        if self.word not in options.overrides:
            return False
        if options.multirun:
            raise InputError("--multirun", self.word, f"left out with {self.word}", self.one_at_a_time)
        for override in options.overrides:
            name = setting_of(override)
            if name in self.left_out:
                raise InputError(name, override.partition("=")[2], f"left out with {self.word}", self.hint)
        options.overrides.remove(self.word)
        if self.directory and not any(setting_of(o) == setting_of(self.directory) for o in options.overrides):
            options.overrides.append(self.directory)
        return True


# What goes on with a run, or makes several, has nothing to do with a look at a record.
INSPECT = Subcommand("inspect", ("resume", "collect", "model"), "one record is looked at at a time")
# Its directory is the same at every start, so that the same command goes on.
FOLLOW = Subcommand(
    "follow",
    ("resume", "collect"),
    "one record is followed at a time",
    "the same command goes on where it was",
    "hydra.run.dir=outputs/${case}/follow",
)
