"""The table and the figure of the referee, by family."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd

from benchmarks.trust.families import FAMILIES
from benchmarks.trust.score import CAUGHT, ERROR, FALSE_ALARM, LEVELS, OUTCOMES, SOUND, WRONG_AND_SOUND, inside
from benchmarks.written import markdown

ALL = "all"
A_MOVE = 0.1  # standard deviations; and as a share, of a deviation itself
COLOURS = {SOUND: "#4c9f70", FALSE_ALARM: "#f0c05a", CAUGHT: "#6d8fc7", WRONG_AND_SOUND: "#c03a2b", ERROR: "#777777"}
COSTS = ("seconds", "elapsed", "mebibytes")  # of a row, and not of what it says
BANDS = {"u": "u", "v": "u'", "a": "u''"}


@dataclass(frozen=True)
class Judged:
    """The rows of the cases of one program, and those of their parameters."""

    rows: pd.DataFrame
    parameters: pd.DataFrame


def by_family(judged: Judged) -> pd.DataFrame:
    """A row for each family and one for all.

    Columns: cases, one for each outcome, `named` (of those with a fault), share of true parameters in their intervals
    of 50, 90 and 95 % and rms of z, the same of u, u' and u'' at DOFs without a sensor, seconds of processor time and
    MiB, both the median. Coverage is that of cases without a fault.
    """
    rows, parameters, found = judged.rows, judged.parameters, []
    for family in [*(one for one in FAMILIES if (rows["family"] == one).any()), ALL]:
        part = rows if family == ALL else rows[rows["family"] == family]
        line: dict[str, object] = {"family": family, "cases": len(part)}
        line |= {outcome: int((part["outcome"] == outcome).sum()) for outcome in OUTCOMES}
        faulty = part["fault"].fillna("") != ""
        told = int((part.loc[faulty, "named"] == 1).sum())
        line["named"] = f"{told} of {int(faulty.sum())}" if faulty.any() else ""
        fair = part[~faulty] if family == ALL or not faulty.all() else part[faulty].iloc[:0]
        line |= _coverage(parameters[parameters["case"].isin(fair["case"])])
        for letter in BANDS:
            # A band counts once for each case, however many DOFs and samples it has.
            line |= {f"{letter}_{level}": 100.0 * _mean(fair, f"{letter}_{level}") for level in LEVELS}
            line[f"{letter}_rms"] = np.sqrt(_mean(fair, f"{letter}_rms", power=2))
        line |= {name: _median(part, name) for name in ("seconds", "mebibytes")}
        found.append(line)
    return pd.DataFrame(found)


def _coverage(table: pd.DataFrame) -> dict[str, float]:
    table = table.dropna(subset=["estimate", "std", "lower_90", "upper_90"])
    if table.empty:
        return {f"p_{level}": np.nan for level in LEVELS} | {"p_rms": np.nan}
    z = ((table["estimate"] - table["true"]) / table["std"]).abs().clip(upper=1e3)
    held = {f"p_{level}": 100.0 * float(np.mean(ok)) for level, ok in inside(table).items()}
    return held | {"p_rms": float(np.sqrt(np.mean(z**2)))}


def _mean(rows: pd.DataFrame, column: str, power: int = 1) -> float:
    values = rows[column].dropna() if column in rows else pd.Series(dtype=float)
    return float(np.mean(values**power)) if len(values) else np.nan


def _median(rows: pd.DataFrame, column: str) -> float:
    return float(rows[column].median()) if column in rows else np.nan


def outcomes(table: pd.DataFrame) -> str:
    """Cases by outcome, with processor time and memory, in Markdown."""
    first = ["family", "cases", *OUTCOMES, "named", "seconds", "mebibytes"]
    heads = [f"**{name}**" if name == WRONG_AND_SOUND else name for name in first]
    return markdown(pd.DataFrame([[_cell(row[name]) for name in first] for _, row in table.iterrows()], columns=heads))


def coverage(table: pd.DataFrame) -> str:
    """Shares of truths inside intervals and bands, %, and rms of their distances in deviations, in Markdown."""
    kinds = {"p": "parameters", **BANDS}
    columns = {f"{letter}_{level}": f"{name} {level}" for letter, name in kinds.items() for level in LEVELS}
    columns |= {f"{letter}_rms": f"z of {name}" for letter, name in kinds.items()}
    held = table.dropna(subset=list(columns), how="all")
    cells = [[row["family"], *(_cell(row[name]) for name in columns)] for _, row in held.iterrows()]
    return markdown(pd.DataFrame(cells, columns=["family", *columns.values()]))


def by_peers(judged: Judged, peers: pd.DataFrame) -> str:
    """How far off other methods are, over how far off the program is, and their processor time over its, in Markdown.

    The median over the cases that a peer can do of the ratio of root mean square relative errors. They are told the
    noise levels.
    """
    both = peers.merge(judged.parameters, on=["case", "parameter"], suffixes=("", "_ours"))
    both["theirs"] = (both["estimate"] / both["true"] - 1.0) ** 2
    both["ours"] = (both["estimate_ours"] / both["true"] - 1.0) ** 2
    cases = both.groupby(["family", "peer", "case"], sort=False).agg(
        theirs=("theirs", "mean"), ours=("ours", "mean"), seconds=("seconds", "first")
    )
    cases = cases.reset_index().merge(judged.rows[["case", "seconds"]], on="case", suffixes=("", "_ours"))
    cells = []
    for (family, peer), part in cases.groupby(["family", "peer"], sort=False):
        ratio = np.sqrt(part["theirs"] / part["ours"]).fillna(np.inf)  # where it failed
        slower = part["seconds"] / part["seconds_ours"]
        cells.append([family, peer, len(part), _cell(float(ratio.median())), _cell(float(slower.median()))])
    return markdown(pd.DataFrame(cells, columns=["family", "peer", "cases", "error over ours", "seconds over ours"]))


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.3g}" if value < 1000 else f"{value:.0f}"
    return str(value)


def worst(rows: pd.DataFrame, number: int = 5) -> str:
    """The worst cases of each family: wrong and sound first, then errors, false alarms and the furthest off."""
    order = {WRONG_AND_SOUND: 0, ERROR: 1, FALSE_ALARM: 2, CAUGHT: 3, SOUND: 4}
    lines = []
    for _, of in rows.fillna({"reasons": ""}).groupby("family", sort=False):
        part = of.assign(rank=of["outcome"].map(order)).sort_values(["rank", "worst_z"], ascending=[True, False])
        for _, row in part[part["outcome"] != SOUND].head(number).iterrows():
            off = "no parameter"
            if isinstance(row["worst_parameter"], str):
                off = f"{row['worst_parameter']} {row['worst_percent']:.3g} %, {row['worst_z']:.3g} std"
            lines.append(f"{row['case']}: {row['outcome']}; {off}; {row['about']}; {str(row['reasons'])[:160]}")
    return "\n".join(lines)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Outcomes by family, and how many of the intervals of 90 % hold the truth."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11.0, 0.42 * len(table) + 1.6), sharey=True, layout="constrained"
    )
    place = np.arange(len(table))[::-1]
    start = np.zeros(len(table))
    for outcome in OUTCOMES:
        share = 100.0 * table[outcome].to_numpy(float) / table["cases"].to_numpy(float)
        left.barh(place, share, left=start, color=COLOURS[outcome], label=outcome)
        start += share
    left.set_yticks(
        place, [f"{family} ({cases})" for family, cases in zip(table["family"], table["cases"], strict=True)]
    )
    left.set_xlabel("cases, %")
    left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8)
    for letter, name, marker in zip(("p", *BANDS), ("parameters", *BANDS.values()), "osd^", strict=True):
        right.plot(table[f"{letter}_90"], place, marker, label=name, markersize=5)
    right.axvline(90.0, color="0.3", linewidth=1.0)
    right.set_xlim(0.0, 102.0)
    right.grid(axis="x", color="0.9")
    right.set_xlabel("inside their 90 % intervals, %")
    right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def moves(before: Judged, after: Judged) -> pd.DataFrame:
    """A row for each case of two programs.

    Columns: case, outcome and `outcome_new`, the parameter that moved most, by how many of its deviations and how much
    wider its new deviation is, how much slower the run was, `judged` (another outcome), `differs` (anything but time
    and memory).
    """
    parameters = before.parameters.merge(after.parameters, on=["case", "parameter"], suffixes=("", "_new"))
    parameters["moved"] = (parameters["estimate_new"] - parameters["estimate"]).abs() / parameters["std"]
    parameters["wider"] = parameters["std_new"] / parameters["std"]
    most = parameters.sort_values("moved", ascending=False).groupby("case").first()[["parameter", "moved", "wider"]]
    # A run that ended in an error has no costs.
    rows = after.rows.reindex(columns=after.rows.columns.union(before.rows.columns, sort=False))
    both = before.rows.merge(rows, on="case", suffixes=("", "_new")).merge(most, on="case", how="left")
    both["judged"] = both["outcome"] != both["outcome_new"]
    both["slower"] = both["seconds_new"] / both["seconds"]
    both["differs"] = (both["moved"].fillna(0.0) > 0.0) | (both["wider"].fillna(1.0) != 1.0)
    for name in before.rows.columns.intersection(after.rows.columns).difference(["case", *COSTS]):
        one, other = both[name], both[f"{name}_new"]
        both["differs"] |= (one != other) & ~(one.isna() & other.isna())
    columns = ["case", "outcome", "outcome_new", "parameter", "moved", "wider", "slower", "judged", "differs"]
    return both[columns]


def changes(before: Judged, after: Judged) -> pd.DataFrame:
    """Of `moves`, cases that are judged differently, or whose parameters moved or became surer by `A_MOVE` or more."""
    both = moves(before, after)
    found = both[both["judged"] | (both["moved"] > A_MOVE) | ((both["wider"] - 1.0).abs() > A_MOVE)]
    return found.sort_values(["judged", "moved"], ascending=False).drop(columns=["judged", "differs"])
