"""A sheet as Markdown and as LaTeX (booktabs); ``report.html.j2`` has it as HTML."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.paper.sheet import SIGNS, written

if TYPE_CHECKING:
    from pinn_cli.paper.sheet import Cell, Sheet

_LATEX_MARKS = {"": "{}", "better": r"\textbf{{{}}}", "worse": r"\underline{{{}}}"}
MARKS_NOTE = "{better} marks a value that is better than the published one, {worse} one that is worse.".format(**SIGNS)
LATEX_MARKS_NOTE = "Bold: better than the published value; underlined: worse."


def markdown(sheet: Sheet) -> str:
    """A Markdown table; Markdown has no groups of columns, so each column's title names its group."""
    groups = [title for title, span in sheet.groups for _ in range(span)]
    titles = [
        f"{group}: {written(column, 'plain')}" if group else written(column, "plain")
        for group, column in zip(groups, sheet.columns, strict=True)
    ]
    lines = [f"# {sheet.title}", "", f"{sheet.note} {MARKS_NOTE}", ""]
    lines.append(_markdown_row(*sheet.heads, *titles))
    lines.append(_markdown_row(*("---" for _ in sheet.heads), *("---:" for _ in titles)))
    for row in sheet.rows:
        heads = (written(head, "plain") for head in row.heads)
        lines.append(_markdown_row(*heads, *(f"{cell.text} {SIGNS[cell.mark]}".strip() for cell in row.cells)))
    return "\n".join(lines)


def _markdown_row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def latex(sheet: Sheet) -> str:
    r"""A ``table*`` for ``\input``; the document needs ``\usepackage{booktabs,graphicx}``."""
    columns = "l" * len(sheet.heads) + "r" * len(sheet.columns)
    lines = [
        "% needs \\usepackage{booktabs,graphicx}",
        r"\begin{table*}",
        rf"\caption{{{written(sheet.title, 'latex')}. {written(sheet.note, 'latex')} {LATEX_MARKS_NOTE}}}",
        rf"\label{{tab:{sheet.name}}}",
        r"\centering",
        r"\resizebox{\textwidth}{!}{%",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        *_latex_groups(sheet),
        _latex_row([written(text, "latex") for text in (*sheet.heads, *sheet.columns)]),
        r"\midrule",
    ]
    for position, row in enumerate(sheet.rows):
        lines += [r"\midrule"] if row.begins and position else []
        heads = [written(head, "latex") for head in row.heads]
        lines.append(_latex_row([*heads, *map(_latex_cell, row.cells)]))
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}}", r"\end{table*}"])


def _latex_groups(sheet: Sheet) -> list[str]:
    if not sheet.grouped:
        return []
    cells, rules, column = [""] * len(sheet.heads), [], len(sheet.heads) + 1
    for title, span in sheet.groups:
        cells.append(rf"\multicolumn{{{span}}}{{c}}{{{written(title, 'latex')}}}")
        rules.append(rf"\cmidrule(lr){{{column}-{column + span - 1}}}")
        column += span
    return [_latex_row(cells), "".join(rules)]


def _latex_row(cells: list[str]) -> str:
    return " & ".join(cells) + r" \\"


def _latex_cell(cell: Cell) -> str:
    return _LATEX_MARKS[cell.mark].format(written(cell.text, "latex"))
