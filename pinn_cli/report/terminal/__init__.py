"""What a run prints at its end, as plain text that fits 100 columns."""

from pinn_cli.report.terminal.columns import MARK, WIDTH, percent
from pinn_cli.report.terminal.fitness import fitness_text, free_run_line, free_run_text
from pinn_cli.report.terminal.parameters import PARAMETERS_SHOWN, diagnostics_text, parameters_text
from pinn_cli.report.terminal.sensors import sensors_text
from pinn_cli.report.terminal.verdict import verdict_text

__all__ = [
    "MARK",
    "PARAMETERS_SHOWN",
    "WIDTH",
    "diagnostics_text",
    "fitness_text",
    "free_run_line",
    "free_run_text",
    "parameters_text",
    "percent",
    "sensors_text",
    "verdict_text",
]
