"""What a run prints: its tables, and what is said in sentences of changes, of peaks, of its score, and its verdict."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.system.quantities import GROUND, SUPPORT, UNITS

if TYPE_CHECKING:
    from pinn_cli.report.free_run import FreeRun, ValidationRun
    from pinn_cli.training.estimate import Changes, Peak, Story
    from pinn_cli.validation.validation import Score
    from pinn_cli.verdict.finding import Verdict

WIDTH, MARK = 100, "! "
SENSORS_SHOWN, PARAMETERS_SHOWN, WARNINGS_SHOWN = 24, 24, 12
PRESCRIBED_BESIDE_UNKNOWN = 8  # what was prescribed is not what such a run is made for
DOFS_SHOWN = 10  # beyond these the rows of single DOFs are left to fitness.csv
# Peaks that are told; all of them stand in the table.
PEAKS_OF, MOST_PEAKS, PARAMETERS_OF_A_STORY = ("drift", "connection_force"), 20, 8
SAID = {
    "force": "a force that the model leaves out acts on every coordinate",
    "smooth force": "a smooth force that the model leaves out acts on {place}",
    "free run": "the structure runs free, and what it misses is left in the sensors",
}
SCORE_UNITS = {
    "heldout": "nats per withheld sample, 0 at best",
    "forecast": "log of error over noise, 0 at best",
    "evidence": "nats, up to a constant of the network",
}


def number(value: float, digits: int = 5) -> str:
    """A number with ``digits`` significant digits, and an exponent only where it would be long without one."""
    if not np.isfinite(value):
        return "-"
    order = math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{max(digits - 1 - order, 0)}f}" if -5 < order < 7 else f"{value:.{digits - 1}e}"


def count(value: float) -> str:
    """A whole number; a dash where there is none."""
    return f"{value:.0f}" if np.isfinite(value) else "-"


def percent(value: float) -> str:
    """A fitness or an error in per cent, short also where it is far off; a dash where there is none."""
    return "-" if not np.isfinite(value) else f"{value:.2f}" if abs(value) < 1e4 else f"{value:.0e}"


@dataclass(frozen=True)
class Column:
    """A column of a printed table: its heading, its width, negative where it is flush left, and the text of a cell.

    What is wider than that makes its column wider.
    """

    title: str
    width: int
    text: Callable[[Any], str] = str

    def aligned(self, cells: Sequence[str]) -> list[str]:
        """The heading and the cells below it, with a blank between them and the column before, or after."""
        texts = [self.title, *cells]
        width = max(abs(self.width), 1 + max(map(len, texts)))
        return [f"{text:>{width}}" if self.width > 0 else f"{text:<{width}}" for text in texts]


def table_lines(columns: Mapping[str, Column], table: pd.DataFrame) -> list[str]:
    """The headings, a rule, and a line per row of the table, with the columns named."""
    rows = table.to_dict(orient="records")
    cells = [column.aligned([column.text(row[name]) for row in rows]) for name, column in columns.items()]
    head, *lines = ("".join(of_row) for of_row in zip(*cells, strict=True))
    return [head, "-" * len(head), *(line.rstrip() for line in lines)]


def marked_lines(sentence: str) -> list[str]:
    """A warning, wrapped, with `MARK` before its first line."""
    return textwrap.wrap(sentence, WIDTH, initial_indent=MARK, subsequent_indent=" " * len(MARK))


_TWO, _THREE, _FOUR = (partial(number, digits=digits) for digits in (2, 3, 4))
_SENSORS = {
    "sensor": Column("sensor", -16),
    "unit": Column("unit", -6),
    "residual_rms": Column("residual rms", 13, _FOUR),
    "sigma": Column("noise", 11, _FOUR),
    "nmse_percent": Column("NMSE (%)", 9, _THREE),
    "free_run_nmse_percent": Column("free run (%)", 13, _THREE),
    "band_share_percent": Column("in band (%)", 12, percent),
}
# What is said, under a table of sensors, of those columns that it has.
_OF_SENSORS = {
    "sigma": "noise: standard deviation found",
    "nmse_percent": "NMSE: mean square residual over the sensor's variance (0: perfect, 100: predicts nothing)",
    "free_run_nmse_percent": "free run: the same of the estimated system under the measured force",
    "band_share_percent": "in band: share of the sensor's power where it stands out of its noise",
    "band_rms": "band: its standard deviation (parameters, start, force, discrepancy as a random force)",
    "inside_95_percent": "inside: samples within 95 %",
}
_VALIDATION = {
    "sensor": Column("validation data", -18),
    "unit": Column("unit", -6),
    "signal_rms": Column("signal rms", 13, _FOUR),
    "error_rms": Column("error rms", 13, _FOUR),
    "nmse_percent": Column("NMSE (%)", 10, _THREE),
    "band_rms": Column("band", 11, _FOUR),
    "inside_95_percent": Column("inside (%)", 12, percent),
}
_INTERVAL = {"std": Column("std", 10, _TWO), "interval": Column("90 % interval", 25)}
_TRUTH = {"true": Column("true", 12, number), "error_percent": Column("error (%)", 10, percent)}
_DIAGNOSTICS = {
    "parameter": Column("parameter", -12),
    "mean": Column("mean", 11, number),
    **_INTERVAL,
    "r_hat": Column("R-hat", 8, _FOUR),
    "ess_bulk": Column("bulk ESS", 10, count),
    "ess_tail": Column("tail ESS", 10, count),
    "mcse_mean": Column("MCSE", 10, _TWO),
}
_HEADINGS = {"displacement": "displ.", "velocity": "veloc.", "acceleration": "accel.", "force": "force"}
_TITLES = ("fitness, 1 - error / deviation (%)", "fitness, 1 - error / range (%)")
_CELL_WIDTH, _GAP = 9, "   "


class Shown(NamedTuple):
    """A table as it is read, in print and on a page: the columns in which anything is known, the rows, and notes."""

    columns: dict[str, Column]
    rows: pd.DataFrame
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, columns: Mapping[str, Column], rows: pd.DataFrame, *notes: str) -> Shown:
        """Without columns of which nothing is known."""
        return cls({name: column for name, column in columns.items() if rows[name].notna().any()}, rows, notes)

    @classmethod
    def of_sensors(cls, columns: Mapping[str, Column], rows: pd.DataFrame, says: str = "", more: str = "") -> Shown:
        """Sensor by sensor; the note has the meanings of the columns, what is said before and what behind."""
        shown = cls.of(columns, rows)
        meanings = [meaning for name, meaning in _OF_SENSORS.items() if name in shown.columns]
        return shown._replace(notes=("; ".join(filter(None, (says, *meanings, more))),))

    def sensors_text(self, file: str) -> str:
        """Of many sensors those with the largest NMSE; the others are left to the file."""
        rows, left_out = self.rows, []
        if len(rows) > SENSORS_SHOWN:
            rows = rows.loc[rows["nmse_percent"].nlargest(SENSORS_SHOWN).index.sort_values()]
            left_out = [f"the {len(rows)} of {len(self.rows)} sensors with the largest NMSE; all: {file}"]
        return "\n".join([*table_lines(self.columns, rows), *left_out, *textwrap.wrap(self.notes[0], WIDTH)])


def sensors_text(records: Sequence[Sequence[pd.DataFrame]], baseline: str = "") -> str:
    """What is left of every sensor beside the noise found; see :func:`sensors_shown`."""
    shown = sensors_shown(records, baseline)
    return "" if shown.rows.empty else shown.sensors_text("residuals.csv")


def sensors_shown(records: Sequence[Sequence[pd.DataFrame]], baseline: str = "") -> Shown:
    """``records`` are the rows of ``residuals.csv`` of every record.

    Of the only one they are also those of a baseline, whose NMSE stands beside ours.
    """
    table = pd.concat([ours.assign(record=i) for i, (ours, *_) in enumerate(records, start=1)], ignore_index=True)
    # ``acceleration 3``, ``ground``, ``support 1`` or the name of a sensor that feels something else.
    quantity = table["quantity"].where(~table["quantity"].isin(list(SUPPORT)), "support")
    names = table["channel"].str.rsplit(" ", n=1).str[-1]
    named = (quantity + " " + table["dof"].astype(str)).where(table["dof"].notna(), names)
    named = named.where((table["quantity"] != GROUND) | table["dof"].isna(), "ground")
    rows, columns = table.assign(sensor=named, unit=table["quantity"].map(UNITS)), dict(_SENSORS)
    if len(records) > 1:
        columns = {"record": Column("record", -7), **columns}
    else:
        for theirs in records[0][1:]:  # with the same sensors in the same order
            rows["baseline"] = theirs["nmse_percent"].to_numpy()
            columns["baseline"] = Column(f"{baseline} (%)", len(baseline) + 5, _THREE)
    return Shown.of_sensors(columns, rows, more="more: residuals.csv")


def validation_text(run: ValidationRun) -> str:
    """Sensor by sensor how far the identified system is from other data."""
    if run.response is None:
        return f"no validation on other data: {run.finding}"
    return validation_shown(run).sensors_text("validation.csv")


def validation_shown(run: ValidationRun) -> Shown:
    """The same to be laid out."""
    times = f"{run.record.time[run.first]:.6g} to {run.record.time[-1]:.6g} s"
    begins = "at rest" if run.at_rest else "where the estimate ends"
    says = f"the identified system under the measured force, {times}, beginning {begins}"
    rows = run.table.assign(sensor=run.table["quantity"] + " " + run.table["dof"].astype(str))
    return Shown.of_sensors(_VALIDATION, rows, says)


def parameters_text(table: pd.DataFrame, warnings: Sequence[str] = (), baseline: pd.DataFrame | None = None) -> str:
    """The parameter table: every unknown parameter, then the prescribed ones, or those of them that moved furthest.

    Args:
        table: From `pinn_cli.report.parameters.parameter_table`, of one run: what has a ``start`` was unknown.
        warnings: From `pinn_cli.report.parameters.identifiability_warnings`, of the same run.
        baseline: Rows of another estimator, with its name. Where the truth is known it leaves no room for them.
    """
    lines: list[str] = []
    for columns, rows, notes in parameters_shown(table, baseline):
        head, rule, *cells = table_lines(columns, rows)
        lines += [*([rule] if lines else []), head, rule, *cells, *notes]
    if table["start"].notna().any():
        lines += ["* unknown: identified from the record; start is where the search for it began"]
        more = [f"and {len(warnings) - WARNINGS_SHOWN} more: identifiability.csv"]
        sentences = [*warnings[:WARNINGS_SHOWN], *(more if len(warnings) > WARNINGS_SHOWN else [])]
        lines += [line for sentence in sentences for line in marked_lines(sentence)]
        lines += [] if warnings else ["every unknown parameter is well determined"]
    return "\n".join(lines)


def curves_text(terms: int) -> str:
    """Where the terms of curves that nobody has a law for are, which say nothing one by one; empty without any."""
    return f"{terms} terms of curves: parameters.csv; the forces with their bands: restoring.csv" if terms else ""


def parameters_shown(table: pd.DataFrame, baseline: pd.DataFrame | None = None) -> list[Shown]:
    """Of the unknown parameters, and behind them of the prescribed ones, with a note of those left out."""
    table, columns = _with_interval(table), {"estimate": Column("estimate", 12, number), **_INTERVAL}
    if table["true"].notna().any():
        columns |= _TRUTH
    elif baseline is not None and len(baseline):
        theirs = table[["parameter"]].merge(baseline, on="parameter", how="left").set_index(table.index)
        table = table.assign(baseline_estimate=theirs["estimate"], baseline_std=theirs["std"])
        columns["baseline_estimate"] = Column(baseline["estimator"].iloc[0], 12, number)
        columns["baseline_std"] = Column("std", 10, _TWO)
    sought = table["start"].notna()
    unknown = table[sought].assign(parameter=table.loc[sought, "parameter"] + " *")
    prescribed, notes = table[~sought], list[str]()
    if len(prescribed) > (limit := PRESCRIBED_BESIDE_UNKNOWN if len(unknown) else PARAMETERS_SHOWN):
        moved = (prescribed["estimate"] / prescribed["prescribed"] - 1.0).abs()
        notes = [f"the {limit} of {len(moved)} that moved furthest from their prescribed values; all: parameters.csv"]
        prescribed = prescribed.loc[moved.nlargest(limit).index.sort_values()]
    first = {"parameter": Column("parameter", -12)}
    return [
        Shown(first | {given: Column(given, 12, number)} | columns, rows, tuple(said))
        for given, rows, said in (("start", unknown, []), ("prescribed", prescribed, notes))
        if len(rows)
    ]


def _with_interval(table: pd.DataFrame) -> pd.DataFrame:
    ends = table[["lower_90", "upper_90"]].to_numpy()
    return table.assign(
        interval=[f"{number(low)} to {number(high)}" if np.isfinite([low, high]).all() else "-" for low, high in ends]
    )


def diagnostics_text(diagnostics: pd.DataFrame, verdict: Sequence[str] = ()) -> str:
    """How well the posterior was sampled, parameter by parameter, and whether that is good enough.

    ``verdict`` says why it is not, in a sentence each. Of many parameters those with the fewest effective draws are
    shown; ``diagnostics`` has the columns of `pinn_cli.report.parameters.DIAGNOSTICS`.
    """
    from pinn_cli.report.parameters import worst_sampled

    table, notes = _with_interval(diagnostics), []
    if len(table) > PARAMETERS_SHOWN:
        table = table[table["parameter"].isin(worst_sampled(table, PARAMETERS_SHOWN))]
        notes = [f"the {len(table)} of {len(diagnostics)} with the fewest effective draws; all: diagnostics.csv"]
    quality = [line for finding in verdict for line in marked_lines(f"quality check FAILED: {finding}")]
    if not verdict and diagnostics["r_hat"].notna().any():
        quality = ["quality check of the sampling passed"]
    elif not verdict:
        quality = ["no chains, so nothing to check: these are independent draws"]
    return "\n".join([*table_lines(_DIAGNOSTICS, table), *notes, *quality])


class Scores(NamedTuple):
    """Fitness by both formulas, %, of what anything is known of: quantities, and by row a name and (2, quantities)."""

    quantities: list[str]
    rows: list[tuple[str, Any]]

    @classmethod
    def of(cls, table: pd.DataFrame, by: str) -> Scores:
        """Of rows as in ``fitness.csv``; the column ``by`` has the names."""
        known = table[np.isfinite(table[list(FORMULAS)]).any(axis=1)]
        quantities = [quantity for quantity in QUANTITIES if quantity in set(known["quantity"])]
        cells = known.set_index([by, "quantity"])[list(FORMULAS)]
        names = dict.fromkeys(known[by])
        return cls(quantities, [(name, cells.loc[name].reindex(quantities).to_numpy().T) for name in names])

    def without_single(self, most: int) -> tuple[Scores, list[str]]:
        """Of more than ``most`` single DOFs none, and those that are left out."""
        single = [name for name, _ in self.rows if name.startswith("dof_")]
        left_out = single if len(single) > most else []
        return self._replace(rows=[row for row in self.rows if row[0] not in left_out]), left_out

    def lines(self, first: str, titles: Sequence[str] = _TITLES, width: int = 12) -> list[str]:
        """Headings, a rule and a line per row: all quantities by one formula after the other."""
        half = _CELL_WIDTH * len(QUANTITIES)

        def line(name: str, halves: Iterable[Iterable[str]]) -> str:
            cells = (f"{''.join(f'{text:>{_CELL_WIDTH}}' for text in texts):<{half}}" for texts in halves)
            return f"{name:<{width}}" + _GAP.join(cells)

        headings = line(first, [[_HEADINGS[quantity] for quantity in self.quantities]] * len(titles))
        lines = [line(name, (map(percent, scores) for scores in halves)).rstrip() for name, halves in self.rows]
        above = " " * width + _GAP.join(f"{title:>{half}}" for title in titles)
        return [above, headings.rstrip(), "-" * len(headings), *lines]


def fitness_text(table: pd.DataFrame, observed: np.ndarray | None = None, published: pd.DataFrame | None = None) -> str:
    """The fitness table with groups as rows and quantities as columns, both formulas side by side, in percent.

    Groups and quantities of which nothing is known are left out: a measured record has a truth at held-out DOFs only.
    Text, or "" if there is no number at all.

    Args:
        table: From `pinn_cli.report.fitness.fitness_table`, of one run.
        observed: (dof,) bool; marks the rows of unobserved DOFs with an asterisk.
        published: From `pinn_cli.report.fitness.published_fitness_of`; its rows are printed under their groups.
    """
    scores, left_out = Scores.of(table, "group").without_single(DOFS_SHOWN)
    if not scores.rows:
        return ""
    unobserved = [] if observed is None else [f"dof_{i}" for i in np.flatnonzero(~np.asarray(observed)) + 1]
    rows: list[tuple[str, Any]] = []
    for name, cells in scores.rows:
        rows.append((f"{name} *" if name in unobserved else name, cells))
        paper = None if published is None else published[published["group"] == name]
        if paper is not None and len(paper):
            rows.append(("  published", ([], paper.groupby("quantity")[FORMULAS[0]].mean().reindex(scores.quantities))))
    notes = [f"{left_out[0]} to {left_out[-1]}: fitness.csv"] if left_out else []
    if any(name in unobserved for name, _ in scores.rows):
        notes.append("* no response sensor on this DOF")
    return "\n".join([*scores._replace(rows=rows).lines("DOFs"), *notes])


def free_run_line(run: FreeRun, table: pd.DataFrame) -> str:
    """What was found of the free run, or else how far its displacements agree with the estimate, in a sentence."""
    row = table[(table["against"] == "estimate") & (table["group"] == "all") & (table["quantity"] == "displacement")]
    agreement = percent(float(row["fitness_percent"].iloc[0]))
    agrees = f"the free run's displacements agree with the estimate's to {agreement} % (mean over DOFs)"
    return textwrap.fill(run.finding or agrees, WIDTH)


def free_run_text(run: FreeRun, table: pd.DataFrame, truth: str = "truth") -> str:
    """The free run's fitness over all DOFs against truth, sensors and estimate, and what was found of it.

    The sensors are left out where the whole truth is known, and quantities of which neither knows anything. ``truth``
    is what the truth is called: of a measured record it is what sensors that were held out have measured.
    """
    finding = textwrap.fill(run.finding, WIDTH)
    if run.response is None:
        return finding
    of_all = table[table["group"] == "all"]
    if of_all.loc[of_all["against"] == "truth", list(FORMULAS)].notna().all(axis=None):
        of_all = of_all[of_all["against"] != "sensors"]
    known = Scores.of(of_all[of_all["against"] != "estimate"], "against").quantities
    scores = Scores.of(of_all[of_all["quantity"].isin(known)].replace({"against": {"truth": truth}}), "against")
    title = "free run: the estimated system from its estimated start under the measured force; mean over DOFs"
    width = max(12, 1 + max((len(name) for name, _ in scores.rows), default=0))
    return "\n".join([title, *scores.lines("against", width=width), *([finding] if finding else [])])


def comparison_text(ours: pd.DataFrame, theirs: pd.DataFrame, seconds: Mapping[str, float]) -> str:
    """Both estimators' fitness over all DOFs and their seconds, ``estimate`` and ``baseline``, in 100 columns.

    Quantities that nobody can score are left out; of a record without any truth the seconds are left.
    """
    names = [str(table["estimator"].iloc[0]) for table in (ours, theirs)]
    taken = [f"{seconds[stage]:.1f}" if stage in seconds else "-" for stage in ("estimate", "baseline")]
    used, both = dict(zip(names, taken, strict=True)), pd.concat([ours, theirs])
    scores = Scores.of(both[both["group"] == "all"], "estimator")
    if not scores.rows:
        return "seconds: " + ", ".join(f"{name} {taken}" for name, taken in used.items())
    lines = scores.lines("estimator", ("mean of 1 - error / deviation (%)", "1 - error / range (%)"), width=16)
    column, full = ["", "seconds", "", *(used[name] for name, _ in scores.rows)], max(map(len, lines))
    return "\n".join(
        f"{line}{'-' * _CELL_WIDTH}" if set(line) == {"-"} else f"{line:<{full}}{text:>{_CELL_WIDTH}}".rstrip()
        for line, text in zip(lines, column, strict=True)
    )


def stories_text(stories: Sequence[Story]) -> str:
    """What is reported, how well each story predicts the record, and what the others say; "" of a model that holds."""
    if not stories:
        return ""
    reported, *others = stories
    lines = [f"The model does not quite hold. The parameters are those of a story in which {_said(reported)}."]
    for story in stories:
        scores = f"{story.name}: NMSE of a free run {story.free_run:.3g} %, of short ones {story.segments:.3g} %"
        lasts = f" N on a DOF, with a correlation time of {story.correlation_time:.3g} s"
        lines.append(f"{scores}{f'; {story.force_std:.3g}{lasts}' if np.isfinite(story.force_std) else ''}.")
    for story in others:
        unknown = [p for p in story.parameters if p.unknown][:PARAMETERS_OF_A_STORY]
        values = ", ".join(f"{p.name} {number(p.estimate)} +- {number(p.std, digits=2)}" for p in unknown)
        lines.append(f"If {_said(story)}: {values} (stories.csv).")
    return "\n".join(textwrap.fill(line, WIDTH, break_on_hyphens=False) for line in lines)


def _said(story: Story) -> str:
    return SAID[story.name].format(place=f"{story.place} alone" if story.place else "every coordinate")


def changes_text(changes: Changes | None) -> str:
    """What changed since earlier records; "" without any, and of a contradiction: the verdict tells it."""
    if changes is None or (not changes.found and changes.chance < changes.improbable):
        return ""
    if not changes.found:
        return f"no change since the earlier records (probability of such differences by chance: {changes.chance:.2g})"
    lines = []
    for change in changes.found:
        p, much = change.parameter, f"by {change.by:+.3g} +- {change.std:.1g} {change.parameter.unit}"
        if p.prescribed:
            by, std = 100.0 * change.by / p.prescribed, 100.0 * change.std / abs(p.prescribed)
            much = f"by {by:+.2g} +- {std:.1g} %"
        chance = f"{change.chance:.1g}" if change.chance >= 1e-12 else "below 1e-12"
        share = f"{100.0 * change.share:.3g} % that it is this parameter"
        lines.append(f"changed: {p.name} ({p.owner}) {much}; by chance {chance}; {share}")
    return "\n".join(lines)


def peaks_text(peaks: Sequence[Peak]) -> str:
    """Peak drifts and forces of the connections; "" without a prediction."""
    if not peaks:
        return ""
    lines = [
        f"peak {peak.quantity.replace('_', ' ')} of connection {peak.of}: {_FOUR(peak.peak)} {peak.unit}"
        f" at {peak.time:.4g} s, 90 %: {_FOUR(peak.lower_90)} to {_FOUR(peak.upper_90)}"
        for peak in [peak for peak in peaks if peak.quantity in PEAKS_OF][:MOST_PEAKS]
    ]
    return "\n".join([*lines, f"{len(peaks)} peaks with intervals: peaks.csv"])


def score_text(name: str, score: Score | None) -> str:
    """The line of the validation; empty without one."""
    if score is None:
        return ""
    value = f"{score.value:.5g}" if np.isfinite(score.value) else f"none: {score.reason}"
    return f"validation score ({name}; {SCORE_UNITS.get(name, 'lower is better')}): {value}"


def verdict_text(verdict: Verdict) -> str:
    """The verdict in one line, the last but one of a run; what is not sound has its reasons above it."""
    folded = textwrap.TextWrapper(WIDTH, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False)
    reasons = [folded.fill(finding.text) for finding in verdict.reasons]
    return "\n".join([*reasons, f"verdict: {verdict.word}"])
