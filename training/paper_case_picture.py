"""The waterfall of the gap, a panel a regime, on a logarithmic axis: it falls by three decades."""

import io
from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

DPI = 80  # the picture lies in the repository
SERIES = (("train", "training runs", "tab:blue", -0.2), ("test", "scenarios", "tab:orange", 0.2))


def waterfall_picture(documents: Mapping[str, Mapping[str, Any]]) -> bytes:
    """PNG of diagnosis.json by regime."""
    most = max(len(document["waterfall"]) for document in documents.values())
    errors = [step["train_rmse_k"] for document in documents.values() for step in document["waterfall"]]
    figure = Figure(figsize=(10, 1.6 + 0.36 * most), layout="constrained")
    panels = figure.subplots(1, len(documents), squeeze=False, sharex=True)[0]
    for axes, (regime, document) in zip(panels, documents.items(), strict=True):
        _draw(axes, document)
        axes.set_title(f"{regime.capitalize()}: the gap, effect by effect")
    panels[0].set_xlim(0.5 * min(errors), 4.0 * max(errors))
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI, pil_kwargs={"optimize": True})
    return out.getvalue()


def _draw(axes: Axes, document: Mapping[str, Any]) -> None:
    steps, floor = document["waterfall"], document["gap"]["noise_floor"]
    rows = range(len(steps))
    for role, label, colour, shift in SERIES:
        errors = [step[f"{role}_rmse_k"] for step in steps]
        axes.barh([row + shift for row in rows], errors, 0.38, color=colour, label=label)
        for row, error in zip(rows, errors, strict=True):
            place = (error, row + shift)
            axes.annotate(f"{error:.3g}", place, (3, 0), textcoords="offset points", va="center", fontsize=7)
        axes.axvline(floor[role], color=colour, linestyle=":", linewidth=1.2)
    axes.set_xscale("log")
    axes.set_yticks(rows, [f"+ {step['effects'][-1]}" if step["effects"] else "bare PBM" for step in steps])
    axes.invert_yaxis()
    axes.set_xlabel("RMSE of free runs [K]; dotted: noise floor")
    axes.legend(fontsize="small", loc="lower right")
