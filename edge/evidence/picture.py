"""The air of a whole record in one picture, with the reference, marks and missing days."""

import importlib.util

import numpy as np

from edge.diagnosis.report.picture import AFTER, BEFORE, PLAIN, Picture, legend_above, new_figure, style, svg
from edge.evidence.chain_files import DAY_S, begin_of
from edge.evidence.figures import days_without_data
from edge.evidence.proof import ProvenRecord
from edge.evidence.record_table import Floats, RecordTable

HEIGHT_IN = 2.8
HOUR_S = 3600.0


def air_picture(record: ProvenRecord, table: RecordTable) -> Picture | None:
    """Return the picture, None without matplotlib or without a good reading."""
    if importlib.util.find_spec("matplotlib") is None or np.isnan(table.air_c).all():
        return None
    zero_utc = begin_of(record.days[0].date)
    hours, low, high, reference = _hourly(table, zero_utc, len(record.days))
    with style():
        figure = new_figure(HEIGHT_IN)
        axes = figure.subplots()
        axes.fill_between(hours / 24.0, low, high, color=AFTER, alpha=0.6, linewidth=0, label="air")
        axes.plot(hours / 24.0, reference, color=BEFORE, linewidth=0.9, label="reference")
        for day, _ in days_without_data(record, table):
            first = (begin_of(day.date) - zero_utc) / DAY_S
            axes.axvspan(first, first + 1.0, color=PLAIN, alpha=0.25, linewidth=0)
        for span in table.marked:
            axes.axvline((span.begin_utc - zero_utc) / DAY_S, color=PLAIN, linewidth=0.7, linestyle=":")
        axes.set_title("Air and reference")
        axes.set_xlabel(f"days since {record.days[0].date}")
        axes.set_ylabel("°C")
        axes.set_xlim(0.0, float(len(record.days)))
        legend_above(axes, 2)
        return Picture(
            svg(figure),
            "Air and reference over the record",
            "Lowest to highest good reading of each hour, and the reference. Grey: days without data. "
            "Dotted: a mark begins.",
        )


def _hourly(table: RecordTable, zero_utc: float, days: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return hours since `zero_utc`, lowest and highest air, and mean reference, NaN where unknown."""
    hour = np.floor((table.utc - zero_utc) / HOUR_S)
    is_known = ~np.isnan(table.air_c)
    hours = np.arange(24 * days, dtype=np.float64)  # ticks of a wrong clock lie outside
    found = np.full((3, len(hours)), np.nan)
    for place, one in enumerate(hours):
        rows = is_known & (hour == one)
        if rows.any():
            reference = table.reference_c[rows]
            known = reference[~np.isnan(reference)]
            mean = float(known.mean()) if len(known) else np.nan
            found[:, place] = table.air_c[rows].min(), table.air_c[rows].max(), mean
    return hours + 0.5, found[0], found[1], found[2]
