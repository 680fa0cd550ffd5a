"""Values for Hydra's command line."""

from __future__ import annotations

import re


def quoted(value: str) -> str:
    """A value that Hydra's grammar takes as it stands, whatever characters a folder's name has."""
    # A backslash is itself but before a quotation mark, where it is written twice.
    escaped = re.sub(r"(\\*)('|$)", lambda found: found[1] * 2 + ("\\'" if found[2] else ""), value)
    return f"'{escaped}'"


def setting_of(override: str) -> str:
    """The setting that an override is about, whatever it does with it: `seed` of `seed=0`, `++seed=0` and `~seed`."""
    return override.partition("=")[0].lstrip("+~")
