"""Which runs the paper's tables and figures need: every case with each of its variants, each once."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pinn_cli.paper.case_runs import Variant
from pinn_cli.paper.single_tables import FITNESS_TABLES, PARAMETER_TABLES, CaseTable
from pinn_cli.report import published

SMOOTHER = Variant("kalman_smoother", "Kalman smoother")
_BESIDE = ("baseline=kalman_smoother",)


@dataclass(frozen=True)
class PlannedRun:
    """One run of the paper.

    Attributes:
        case: Of ``conf/experiment/paper``.
        variant: How it is run; the first variant of a table has the Kalman smoother beside it.
    """

    case: str
    variant: Variant

    @property
    def name(self) -> str:
        """Of its directory."""
        return f"{self.case}_{self.variant.name}"


def case_tables() -> tuple[CaseTable, ...]:
    """Tables 2 to 6 in the paper's order."""
    return tuple(sorted((*FITNESS_TABLES, *PARAMETER_TABLES), key=lambda table: table.name))


def cases_of(table: CaseTable) -> list[str]:
    """The table's cases in the paper's order."""
    values = published.fitness() if table in FITNESS_TABLES else published.parameters()
    return list(dict.fromkeys(values.loc[values["table"] == table.published, "case"]))


def planned_runs() -> list[PlannedRun]:
    """The runs of Tables 2 to 6, in their order; a case that stands in two tables is run once."""
    runs = [
        PlannedRun(case, variant)
        for table in case_tables()
        for case in cases_of(table)
        for variant in _with_smoother(table.variants)
    ]
    return list(dict.fromkeys(runs))


def source_title(variant: Variant) -> str:
    """What a row of a table calls a variant."""
    return variant.title if variant.name == SMOOTHER.name else f"ours, {variant.title}"


def _with_smoother(variants: tuple[Variant, ...]) -> tuple[Variant, ...]:
    """The first variant solves the same problem by the smoother too."""
    first, *others = variants
    return (replace(first, overrides=(*first.overrides, *_BESIDE)), *others)
