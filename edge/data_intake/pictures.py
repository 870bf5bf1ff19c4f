"""A picture of a log's columns over time."""

from pathlib import Path

from edge.core.errors import RequestError
from edge.data_intake.look import LogLook

HEIGHT_IN = 1.1  # of a column's strip


def draw(found: LogLook, path: Path) -> None:
    """Columns that are taken for something. Errors: RequestError without matplotlib; OSError"""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise RequestError("a picture needs matplotlib: pip install matplotlib") from None
    shown = [
        (target, source) for target, source in found.mapping.columns.items() if source.column in found.values
    ]
    figure = Figure(figsize=(9, 0.8 + HEIGHT_IN * max(len(shown), 1)), layout="constrained")
    strips = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False)[:, 0]
    hours = (found.time_s - found.time_s[0]) / 3600.0
    for strip, (target, source) in zip(strips, shown, strict=False):
        strip.plot(hours, found.values[source.column], linewidth=0.9)
        strip.set_title(f"{source.column} as {target}, in {source.unit}", fontsize="small", loc="left")
    strips[-1].set_xlabel("time [h]")
    figure.savefig(path, dpi=110)
