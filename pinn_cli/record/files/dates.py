"""Dates and times of day as seconds: ISO 8601, and as people and loggers write them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pandas as pd

_DAY = r"(\d{1,4})[-./](\d{1,2})[-./](\d{1,4})"
_CLOCK = r"(\d{1,3}):(\d{2})(?::(\d{2}(?:[.,]\d*)?))?"
_ZONE = r"(?:Z|[A-Z]{2,5}|(?:UTC|GMT)?\s*([+-])(\d{1,2}):?(\d{2})?)"
_WRITTEN = re.compile(rf"\s*(?:{_DAY}[,T]?\s*)?(?:{_CLOCK})?\s*([AaPp]\.?[Mm]\.?)?\s*({_ZONE})?\s*")
# Which of the three numbers is the year, the month and the day, in the order in which they are tried.
_ORDERS = ((2, 1, 0), (2, 0, 1), (0, 1, 2))
_DAY_S = 86400.0


def seconds_of(texts: Sequence[str]) -> np.ndarray | None:
    """Seconds (N,) from the first of some dates or times of day; None: one of them is none.

    Of numbers such as 3/4/2026 the one is the day by which the record takes least time. Times of day without a date go
    on after midnight.
    """
    dates = pd.to_datetime(pd.Series(texts), format="ISO8601", errors="coerce", utc=True)
    if not dates.isna().any():
        return np.asarray((dates - dates.iloc[0]).dt.total_seconds(), dtype=np.float64)
    found = [_WRITTEN.fullmatch(text) for text in texts]
    parts = [match.groups() for match in found if match is not None and any(match.groups()[:5])]
    if len(parts) < len(texts):
        return None
    zones = {part[7] for part in parts if part[8] is None}
    if len(zones) > 1 or (zones and len(zones) < len({part[7] for part in parts})):  # names of zones, which change
        return None
    clock = np.array([_of_the_day(part) for part in parts])
    if all(part[0] is None for part in parts):
        turns = np.concatenate(([0], np.cumsum(np.diff(clock) < -0.5 * _DAY_S)))
        return np.asarray(clock + _DAY_S * turns - clock[0])
    days = _days([part[:3] for part in parts])
    return None if days is None else np.asarray(clock - clock[0] + _DAY_S * (days - days[0]))


def first_other(texts: Sequence[str]) -> int | None:
    """Place of the first text that is no date or time of day, where the first one of all is; else None."""
    others = (i for i, text in enumerate(texts) if _WRITTEN.fullmatch(text) is None)
    return next(others, None) or None


def _of_the_day(part: Sequence[str | None]) -> float:
    """Seconds since midnight, of UTC where the zone is a number."""
    hours, minutes, seconds, half, _, sign, zone_hours, zone_minutes = part[3:]
    hour = int(hours or 0)
    if half:
        hour = hour % 12 + (12 if half[0] in "Pp" else 0)
    shift = 0 if sign is None else 3600 * int(zone_hours or 0) + 60 * int(zone_minutes or 0)
    shift = -shift if sign == "-" else shift
    return 3600.0 * hour + 60.0 * int(minutes or 0) + float((seconds or "0").replace(",", ".")) - shift


def _days(parts: Sequence[Sequence[str | None]]) -> np.ndarray | None:
    """Days (N,) since some day; None: there is no order of day, month and year in which all are dates."""
    if any(part[0] is None for part in parts):
        return None
    different = list(dict.fromkeys(tuple(part) for part in parts))
    tried = []
    for year, month, day in _ORDERS:
        columns = {"year": year, "month": month, "day": day}
        frame = pd.DataFrame({name: [int(part[i] or 0) for part in different] for name, i in columns.items()})
        frame["year"] += np.where(frame["year"] < 100, 2000, 0)
        days = (pd.to_datetime(frame, errors="coerce") - pd.Timestamp(2000, 1, 1)).dt.days
        if not days.isna().any():
            tried.append(dict(zip(different, days, strict=True)))
    if not tried:
        return None
    best = min(tried, key=lambda days: max(days.values()) - min(days.values()))
    return np.array([best[tuple(part)] for part in parts], dtype=np.float64)
