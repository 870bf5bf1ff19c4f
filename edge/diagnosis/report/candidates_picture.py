"""Picture of the gain of each candidate, round by round."""

from typing import TYPE_CHECKING

from edge.diagnosis.diagnosis_document import CandidateEntry, DiagnosisDocument, RoundEntry
from edge.diagnosis.report.number_text import nats
from edge.diagnosis.report.picture import AFTER, INK, PLAIN, Picture, new_figure, style, svg
from edge.diagnosis.report.wording import join_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROUNDS, SHOWN = 4, 8  # more are in the table
BAR_IN, ROUND_IN, BORDER_IN = 0.22, 0.38, 0.5
LEAST_NATS = 1.0  # the axis is linear below: such a gain is chance


def candidates_picture(document: DiagnosisDocument) -> Picture | None:
    """None where no gain is known."""
    rounds = [one for one in document.get("rounds", []) if _rank(one)][:ROUNDS]
    if not rounds:
        return None
    rows = [len(_rank(one)) for one in rounds]
    kept = any(candidate["kept"] for one in rounds for candidate in one["candidates"])
    with style():
        figure = new_figure(BAR_IN * sum(rows) + ROUND_IN * len(rows) + BORDER_IN)
        panels = figure.subplots(
            len(rows), 1, sharex=True, squeeze=False, height_ratios=[n + 0.6 for n in rows]
        )
        for place, (axes, one) in enumerate(zip(panels[:, 0], rounds, strict=True), start=1):
            beside = join_names(one["beside"]) or "the twin as given"
            axes.set_title(f"Round {place}, beside {beside}")
            _draw(axes, _rank(one))
        largest = max(_gain(_rank(one)[0]) for one in rounds)
        # Gains go from tenths to thousands; a plain logarithm has no place for 0.
        axes.set_xscale("symlog", linthresh=LEAST_NATS, linscale=0.3)
        axes.set_xlim(0.0, 6.0 * max(largest, LEAST_NATS))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:.0f}")
        axes.set_xlabel("gain in log likelihood [nat], logarithmic")
        return Picture(
            svg(figure),
            "Gain of each candidate",
            f"{'Blue: kept in the end' if kept else 'None was kept'}. What gains most alone may only stand in"
            " for what is missing, and be needless beside it; the tables say why each was not kept.",
        )


def _draw(axes: "Axes", candidates: list[CandidateEntry]) -> None:
    gains = [max(_gain(one), 0.0) for one in candidates]
    rows = range(len(gains))
    axes.barh(rows, gains, color=[AFTER if one["kept"] else PLAIN for one in candidates], height=0.7)
    for row, (gain, one) in enumerate(zip(gains, candidates, strict=True)):
        text = nats(one["gain_nats"])
        weight = "bold" if one["kept"] else "normal"
        axes.annotate(
            text,
            (gain, row),
            (4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
            color=INK,
            weight=weight,
        )
    axes.set_yticks(rows, [one["name"] for one in candidates])
    axes.set_ylim(len(gains) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)


def _rank(search_round: RoundEntry) -> list[CandidateEntry]:
    """Return the largest gains of a round, and the candidates that were kept."""
    known = [one for one in search_round["candidates"] if one["gain_nats"] is not None]
    ranked = sorted(known, key=_gain, reverse=True)
    return [one for place, one in enumerate(ranked) if place < SHOWN or one["kept"]]


def _gain(candidate: CandidateEntry) -> float:
    """Return the gain of a candidate that was fitted [nat]."""
    return candidate["gain_nats"] or 0.0
