"""What each story of a record says that the model does not quite explain: ``stories.csv``, and a paragraph."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.report.results import with_labels
from pinn_cli.report.terminal.columns import WIDTH, number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pinn_cli.training.estimate import Story

COLUMNS = (
    "story", "parameter", "estimate", "std", "lower_90", "upper_90", "free_run_nmse_percent", "segments_nmse_percent",
)  # fmt: skip
SAID = {
    "force": "a force that the model leaves out acts on every coordinate",
    "free run": "the structure runs free, and what it misses is left in the sensors",
}
SHOWN = 8


def story_table(stories: Sequence[Story], labels: Mapping[str, object]) -> pd.DataFrame:
    """One row per story and parameter, the story that is reported first (the content of ``stories.csv``).

    Columns: the labels and `COLUMNS`; the last two are a story's own, the same for all its parameters: see
    :class:`pinn_cli.training.estimate.Story`.
    """
    rows = [
        (story.name, p.name, p.estimate, p.std, p.lower_90, p.upper_90, story.free_run, story.segments)
        for story in stories
        for p in story.parameters
    ]
    return with_labels(pd.DataFrame(rows, columns=list(COLUMNS)), labels)


def stories_text(stories: Sequence[Story]) -> str:
    """What is reported, how well each story predicts the record, and what the others say; "" of a model that holds."""
    if not stories:
        return ""
    reported, *others = stories
    lines = [f"The model does not quite hold. The parameters are those of a story in which {SAID[reported.name]}."]
    lines += [f"{story.name}: NMSE of a free run {_told(story)}." for story in stories]
    for story in others:
        unknown = [p for p in story.parameters if p.unknown][:SHOWN]
        values = ", ".join(f"{p.name} {number(p.estimate)} +- {number(p.std, digits=2)}" for p in unknown)
        lines.append(f"If {SAID[story.name]}: {values} (stories.csv).")
    return "\n".join(textwrap.fill(line, WIDTH, break_on_hyphens=False) for line in lines)


def _told(story: Story) -> str:
    return f"{story.free_run:.3g} %, of short ones {story.segments:.3g} %"
