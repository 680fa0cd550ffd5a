"""A sheet as Markdown, as LaTeX (booktabs) and as HTML."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.paper.comparison import markdown_row
from pinn_cli.paper.sheet import BETTER_SIGN, WORSE_SIGN, written

if TYPE_CHECKING:
    from pinn_cli.paper.sheet import Cell, Row, Sheet

_SIGNS = {"": "", "better": f" {BETTER_SIGN}", "worse": f" {WORSE_SIGN}"}
_LATEX_MARKS = {"": "{}", "better": r"\textbf{{{}}}", "worse": r"\underline{{{}}}"}
MARKS_NOTE = f"{BETTER_SIGN} marks a value that is better than the published one, {WORSE_SIGN} one that is worse."
LATEX_MARKS_NOTE = "Bold: better than the published value; underlined: worse."


def markdown(sheet: Sheet) -> str:
    """A Markdown table; Markdown has no groups of columns, so each column's title names its group."""
    groups = [title for title, span in sheet.groups for _ in range(span)]
    titles = [
        f"{group}: {written(column, 'plain')}" if group else written(column, "plain")
        for group, column in zip(groups, sheet.columns, strict=True)
    ]
    lines = [f"# {sheet.title}", "", f"{sheet.note} {MARKS_NOTE}", ""]
    lines.append(markdown_row(*sheet.heads, *titles))
    lines.append(markdown_row(*("---" for _ in sheet.heads), *("---:" for _ in titles)))
    for row in sheet.rows:
        heads = (written(head, "plain") for head in row.heads)
        lines.append(markdown_row(*heads, *(cell.text + _SIGNS[cell.mark] for cell in row.cells)))
    return "\n".join(lines)


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
    if not any(title for title, _ in sheet.groups):
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


def html(sheet: Sheet) -> str:
    """A figure element: the table in a frame that scrolls sideways where the screen is narrow."""
    rows = "\n".join(_html_row(row) for row in sheet.rows)
    groups = "".join(
        f'<th colspan="{span}" scope="colgroup">{written(title, "html")}</th>' for title, span in sheet.groups
    )
    named = any(title for title, _ in sheet.groups)
    top = f'<tr><td colspan="{len(sheet.heads)}"></td>{groups}</tr>\n' if named else ""
    titles = "".join(f'<th class="head" scope="col">{written(text, "html")}</th>' for text in sheet.heads)
    titles += "".join(f'<th scope="col">{written(text, "html")}</th>' for text in sheet.columns)
    return (
        f'<figure class="table" id="{sheet.name}">\n'
        f"<figcaption><b>{written(sheet.title, 'html')}.</b> {written(sheet.note, 'html')}</figcaption>\n"
        f'<div class="scroll" tabindex="0"><table>\n<thead>\n{top}<tr>{titles}</tr>\n</thead>\n'
        f"<tbody>\n{rows}\n</tbody>\n</table></div>\n</figure>"
    )


def _html_row(row: Row) -> str:
    names = " ".join(name for name, on in (("begins", row.begins), ("secondary", row.secondary)) if on)
    heads = "".join(f'<th scope="row">{written(head, "html")}</th>' for head in row.heads)
    return f'<tr class="{names}">{heads}{"".join(map(_html_cell, row.cells))}</tr>'


def _html_cell(cell: Cell) -> str:
    # The sign says without colour what the colour says.
    sign = f"<span>{_SIGNS[cell.mark].strip()}</span>" if cell.mark else ""
    mark = f' class="{cell.mark}"' if cell.mark else ""
    return f"<td{mark}>{written(cell.text, 'html')}{sign}</td>"
