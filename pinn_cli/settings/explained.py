"""What the files of conf/ say of their settings, comments included, which a YAML parser leaves out."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

ENTRY_LINE = re.compile(r"(?P<indent> *)(?P<name>\w+):(?:\s+(?P<value>[^#\s].*?|\"#.*?))??(?:\s+#\s?(?P<comment>.*))?$")
COMMENT = re.compile(r" *#\s?(?P<comment>.*)$")
# What the file is made of, rather than what it sets.
STRUCTURE = ("defaults", "hydra", "_target_", "_convert_", "_partial_", "_recursive_", "kind")


@dataclass(frozen=True)
class Setting:
    """An entry of a file: its name within the file, `sensors.force`, its default as written, and what is said of it."""

    name: str
    default: str
    meaning: str


@dataclass
class SettingsFile:
    """A file of conf/: the comment on top, the class it chooses, and its settings."""

    title: str = ""
    commands: list[str] = field(default_factory=list)
    target: str = ""
    settings: list[Setting] = field(default_factory=list)


def read(file: Path) -> SettingsFile:
    """What a file of conf/ says, comments included, which a YAML parser leaves out."""
    settings_file, skipped = SettingsFile(), -1
    path: list[tuple[int, str]] = []
    top: list[str] = []
    for line in file.read_text(encoding="utf-8").splitlines():
        entry, comment = ENTRY_LINE.fullmatch(line), COMMENT.fullmatch(line)
        if entry:
            depth = len(entry["indent"])
            if -1 < skipped < depth:
                continue
            skipped = -1
            path = [(indent, name) for indent, name in path if indent < depth] + [(depth, entry["name"])]
            if entry["name"] == "_target_" and depth == 0:
                settings_file.target = entry["value"]
            if entry["name"] in STRUCTURE:
                skipped = depth
                continue
            name = ".".join(name for _, name in path)
            settings_file.settings.append(Setting(name, entry["value"] or "", entry["comment"] or ""))
        elif comment and not settings_file.settings and not path:
            top.append(comment["comment"])
        elif comment and settings_file.settings and skipped == -1 and line.startswith("  "):
            last = settings_file.settings[-1]
            settings_file.settings[-1] = replace(last, meaning=f"{last.meaning} {comment['comment'].strip()}".strip())
    settings_file.commands = [line.strip() for line in top if line.startswith("  ")]
    settings_file.title = " ".join(line for line in top if not line.startswith("  ") and not line.startswith("@"))
    return settings_file
