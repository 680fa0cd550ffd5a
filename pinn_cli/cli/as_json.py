"""`--json`: what a run has found, read off its directory, as one JSON object."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

# Of run.json, what a script asks for; and tables, by the name that they have in the object.
_OF_RUN = ("verdict", "reasons")
_TABLES = {"parameters": "parameters.csv", "modes": "modes.csv", "channels": "inspect.csv", "peaks": "peaks.csv"}


def json_of(directory: Path) -> str:
    """The directory; of a run verdict, reasons, parameters and modes, of a look at a record what it shows.

    What is no number is null.
    """
    output: dict[str, Any] = {"directory": str(directory)}
    if (directory / "run.json").is_file():
        content = json.loads((directory / "run.json").read_text(encoding="utf-8"))
        output |= {name: content.get(name) for name in _OF_RUN}
    for name, file in _TABLES.items():
        if (directory / file).is_file():
            output[name] = _rows(directory / file)
    return json.dumps(output, ensure_ascii=False, allow_nan=False)


def _rows(file: Path) -> list[dict[str, Any]]:
    import pandas as pd

    rows = pd.read_csv(file).to_dict(orient="records")
    return [
        {str(k): None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()} for row in rows
    ]
