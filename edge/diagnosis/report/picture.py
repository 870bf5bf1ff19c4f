"""Shared parts of all pictures: colours, lettering, and embedding in a light or dark page."""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 5.2  # narrow, so that the letters are large on a phone
INK = "#010203"  # stands for the page's own text colour
# Told apart by the colour-blind too (Okabe & Ito 2008), and seen on white and on black.
BEFORE, AFTER, FAN, HEATER, PLAIN = "#d9660f", "#1f86cc", "#16a085", "#c9628f", "#8b949c"
# Shortest run [s], divisor, label
UNITS = ((172800.0, 86400.0, "days"), (10800.0, 3600.0, "h"), (300.0, 60.0, "min"), (0.0, 1.0, "s"))
OF_THE_PAGE = {INK: "currentColor", BEFORE: "var(--before)", AFTER: "var(--after)"}  # light or dark
STYLE: Any = {
    "font.size": 9.0,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.labelsize": 8.8,
    "xtick.labelsize": 8.4,
    "ytick.labelsize": 8.4,
    "legend.fontsize": 8.4,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": PLAIN,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "text.parse_math": False,  # names of runs are no formulas
    "axes.unicode_minus": True,
    "svg.fonttype": "path",
    "svg.hashsalt": "diagnosis",
    "path.simplify_threshold": 0.3,
    **dict.fromkeys(
        ("text.color", "axes.labelcolor", "axes.edgecolor", "axes.titlecolor", "xtick.color", "ytick.color"),
        INK,
    ),
}


@dataclass(frozen=True, slots=True)
class Picture:
    """An SVG element for the middle of a page, what it shows, and how to read it."""

    svg: str
    title: str
    caption: str


@contextmanager
def style() -> Iterator[None]:
    """Pictures drawn inside look as ours do."""
    import matplotlib

    with matplotlib.rc_context(STYLE):
        yield


def new_figure(height_in: float) -> "Figure":
    """Return an empty figure, `WIDTH_IN` by `height_in` inches, that pyplot does not hold in memory."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def svg(figure: "Figure") -> str:
    """Return the figure as an element in the page's colours, which change between light and dark."""
    out = io.BytesIO()
    figure.savefig(out, format="svg", dpi=150)
    text = out.getvalue().decode("utf-8")
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = (
        re.sub(r' (xmlns|xmlns:xlink|width|height|version)="[^"]*"', "", text[: (end := text.index(">"))])
        + text[end:]
    )
    # A hundredth of a point is not seen; below 1 a number may be a scale.
    text = re.sub(r"\b[1-9]\d*\.\d{3,}", lambda found: f"{float(found[0]):.2f}", text).replace(" \nL", " L")
    for colour, name in OF_THE_PAGE.items():
        text = text.replace(colour, name)
    return text.replace("xlink:href", "href").strip()


def drawable(name: str, letters: int) -> str:
    """Cut a name to so many letters, without characters that fonts lack,
    such as undecodable bytes of a file name.
    """
    name = name.encode("utf-8", "replace").decode("utf-8")
    return name if len(name) <= letters else name[: letters - 1] + "…"


def time_axis(seconds: float) -> tuple[float, str]:
    """Return divisor and unit for a time axis of that length."""
    return next((divisor, unit) for shortest_s, divisor, unit in UNITS if seconds >= shortest_s)


def legend_above(axes: "Axes", columns: int, room_pt: float = 0.0) -> None:
    """Place a legend between the title and the panel. room_pt : space for text between them"""
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.2 + room_pt / 8.4,
        handlelength=1.6, columnspacing=1.4, borderpad=0.0,
    )  # fmt: skip
    axes.set_title(axes.get_title(loc="left"), pad=18.0 + room_pt)
