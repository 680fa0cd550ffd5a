"""The fixed words and the look of the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.paper.tables import PaperTable

INTRODUCTION = (
    "<p>Haywood-Alexander, Arcieri, Kamariotis and Chatzi, <i>Response Estimation and System Identification of "
    "Dynamical "
    "Systems via Physics-Informed Neural Networks</i>: every table and figure, computed again from the signals of the "
    "authors' public code. Beside each published value stand ours (<code>pinn-run</code> with its defaults, prescribed "
    "parameters uncertain), ours with prescribed parameters held fixed as in the paper, and those of an iterated "
    "extended Kalman smoother given the same record, model and sensors.</p>\n"
    '<p>A value better than the published one is <span class="better">marked like this ▲</span>, a worse one '
    '<span class="worse">like this ▼</span>; no mark: equal at the digits compared.</p>'
)

_FIDELITY = """<ul>
<li><b>Two formulas of fitness.</b> The paper prints 100 (1 − ‖x − x̃‖ / ‖x − x̄‖); its tables hold
100 (1 − RMSE / range), DOF by DOF and then averaged, as the authors' public code computes. They are far apart: an
estimate of zero everywhere scores 0 by the first and about 79 by the second. Published values are compared with the
second; the first stands in the rows called <i>printed</i>.</li>
<li><b>The force is held through each step.</b> The authors' simulation keeps the force constant from sample to sample,
so their motion answers half a step late to what the force's samples say. At 50 dB this is larger than the noise. The
records here are made the same way and say so (<code>simulation.hold=zero_order</code>), and the estimators allow for
it; an estimator that does not, such as the paper's network, cannot be right to the last digits.</li>
<li><b>Seeds.</b> The signals are made with the seeds of the authors' code and an amplitude of 1.30 N rms, where the
paper says 1.0 N. The starting weights of the paper's networks are not published, so its values cannot be had digit by
digit. Each published value is one draw of the noise, and so is ours: at 20 and 10 dB the order of two methods in one
cell may turn with the draw.</li>
{identifiable}<li><b>A linear model has an equivalent stiffness.</b>
Where the estimator is given a linear model of the Duffing chain, the stiffness that fits best is not <i>k</i> but
<i>k</i> plus what the cubic spring adds at the amplitudes of the record. Its distance from <i>k</i>, which the tables
call error, measures the record rather than the estimator.</li>
<li><b>Misprints.</b> The paper once calls DOFs 2 and 4 observed in the state-parameter scheme; its tables and figures
show that they are the unobserved ones, as here.</li>
<li><b>Bayesian cases.</b> Holding the states fixed while the parameters are sampled, as the paper does, gives standard
deviations that are too small (<i>conditional</i>); the default lets the states be uncertain (<i>marginal</i>). The
authors' code trains the network with the true parameters; here they are unknown throughout.</li>
</ul>"""


def fidelity(tables: Sequence[PaperTable]) -> str:
    """Why some of the paper's numbers cannot be matched, as an HTML list, with what the runs found."""
    return _FIDELITY.replace("{identifiable}", _identifiable(tables))


def _identifiable(tables: Sequence[PaperTable]) -> str:
    """An entry on kappa_2 at 10 dB, with the uncertainty that the run found; nothing where there is no such run."""
    for table in tables:
        rows = table.comparison
        if "std" in rows and "variant" in rows:
            ours = rows[(rows["case"] == "sp_5dof_snr10") & (rows["parameter"] == "kappa_2")]
            ours = ours[(ours["variant"] == table.default) & ours["std"].notna()]
            for row in ours.to_dict("records"):
                return (
                    "<li><b>κ<sub>2</sub> at 10 dB is barely identifiable.</b> Its posterior standard deviation is "
                    f"{100.0 * row['std'] / abs(row['true']):.0f} % of its true value. A point estimate close to "
                    f"{row['true']:g} is no sign of a better method; the interval is the result.</li>\n"
                )
    return ""


STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #fff; color: #1a1a1a; }
body { font: 16px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
main { max-width: 76rem; margin: 0 auto; padding: 1rem; }
p, ul, figcaption { max-width: 50rem; }
h1 { font-size: 1.6rem; line-height: 1.2; }
h2 { margin-top: 2.5rem; border-bottom: 1px solid #bbb; }
nav { margin: 1rem 0; }
a { color: #0058a3; }
code { font-size: .85em; overflow-wrap: anywhere; }
figure { margin: 1.5rem 0 2.5rem; }
figcaption { margin: .5rem 0; font-size: .92rem; }
img { display: block; max-width: 100%; height: auto; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .82rem; font-variant-numeric: tabular-nums; }
th, td { padding: .15rem .45rem; text-align: right; white-space: nowrap; }
thead th.head, th[scope=row] { text-align: left; }
tbody th { font-weight: 400; }
thead th { font-weight: 600; border-bottom: 1px solid #333; }
th[colspan], th[scope=colgroup] { text-align: center; }
tr.begins > * { border-top: 1px solid #bbb; }
tr.secondary > * { color: #555; font-size: .76rem; }
td.text { white-space: normal; text-align: left; min-width: 18rem; }
td.better, span.better { background: #e3f3ea; font-weight: 600; }
td.worse, span.worse { background: #fbe9df; }
td span { display: inline-block; width: 1em; margin-left: .15em; font-size: .65em; }
p.worse { background: #fbe9df; padding: .3rem .5rem; }
@media (max-width: 45rem) {
  figure .scroll > img { max-width: none; width: 44rem; }
  tbody th[scope=row], thead th.head { white-space: normal; min-width: 5rem; max-width: 8rem; }
  th, td { padding: .15rem .25rem; }
}
@media print {
  @page { size: A4 landscape; margin: 12mm; }
  body { font-size: 10pt; }
  main { max-width: none; padding: 0; }
  nav { display: none; }
  .scroll { overflow: visible; }
  table { font-size: 7pt; }
  tr.secondary > * { font-size: 6.5pt; }
  th, td { padding: .1rem .25rem; }
  tr { break-inside: avoid; }
  p, ul, figcaption { max-width: none; }
  h2, h3, figure.table figcaption, figure.table tr.begins, figure.table tr.begins ~ tr { break-after: avoid; }
  figure.table tr:has(+ tr.begins) { break-after: auto; }
  figure:not(.table), figcaption { break-inside: avoid; }
  figcaption { font-size: .85rem; }
  img { max-height: 130mm; width: auto; }
  td.better, td.worse, span.better, span.worse { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""
