"""The paper's findings about its controllers, and beside each what the virtual rig shows, in figures.

A finding about a controller that has not run is left out.
"""

from collections.abc import Sequence

import numpy as np

from edge.formats.profile_file import read_profile
from training.control.comparison import Results, column, mae_against, paired, regret, spread_text
from training.control.draw_references import FOLDER
from training.control.effort import FAMILIES, lines, training_s
from training.control.rig import SPARING
from training.control.spread import SENSOR_K, difference, mean_of, ratio
from training.reports.report_findings import ReportFinding, Verdict

PAPERS = ("MPC-BFGS", "RL-Off", "LLM-Te0")  # the paper's three; its MPC is the one by BFGS
EQUAL_KNOWLEDGE = (
    ("MPC-Twin{}/present", "MPC-BFGS{}"),
    ("MPC-Twin{}", "MPC-BFGS{}/preview"),
)  # ours, paper's
SAME_K = 0.1  # a mean MAE that differs by less is called similar
LESS_EFFORT = 0.05  # share of the effort: "less" asks for at least that much
VARIANTS = (
    "/preview",
    "/present",
    "/unbounded",
    "/tuned",
)  # of a controller that stands in the table already


def findings(results: Results, reference: str) -> list[ReportFinding]:
    """In the paper's order, on the reference that its figures show. Verdicts come from the figures."""
    made = (
        _mpc_is_best(results, reference),
        _undecided(results, reference),
        _mpc_toggles(results, reference),
        _rl_fan_always_on(results, reference),
        _penalty_spares(results, reference),
        _mpc_same_with_penalty(results, reference),
        _rl_worse_with_penalty(results, reference),
        _llm_same_with_penalty(results, reference),
        _rl_trains_longest(results, reference),
    )
    return [finding for finding in made if finding is not None]


def beyond(results: Results, references: Sequence[str]) -> list[str]:
    """Return what our own controller does against the paper's that knows as much, pair by pair."""
    return [
        text
        for reference in references
        for ending in ("", "-P")
        for ours, papers in EQUAL_KNOWLEDGE
        if (text := _ours(results, reference, ours.format(ending), papers.format(ending))) is not None
    ]


def _ours(results: Results, reference: str, ours: str, papers: str) -> str | None:
    against = mae_against(results, ours, papers, reference)
    if against is None:
        return None
    found, worth = against
    cost = "sensor_cost_1" if "-P" in ours else "sensor_cost_0"
    times = ratio(*paired(results, papers, ours, reference, (cost, cost)))
    mine, theirs = (regret(results, name, reference, by_sensor=True) for name in (ours, papers))
    wh = [mean_of(column(results, name, reference, "energy_wh")) for name in (ours, papers)]
    text = (
        f"{reference.replace('_', ' ')}: {ours} has a true MAE {spread_text(found, 3)} K from {papers}'s "
        f"({worth} by the sensor's class) with {spread_text(wh[0], 0)} Wh against {spread_text(wh[1], 0)}; "
        f"by the air at the sensor {papers} costs {spread_text(times, 2)} times as much"
    )
    if mine is not None and theirs is not None:
        text += f" ({spread_text(mine, 2)} and {spread_text(theirs, 2)} of the cheapest plan known)"
    return text + "."


def _mpc_is_best(results: Results, reference: str) -> ReportFinding | None:
    means = {name: _mean(results, name, reference, "mae_true") for name in PAPERS}
    known = {name: mean for name, mean in means.items() if mean is not None}
    if len(known) < 2 or PAPERS[0] not in known:
        return None
    beaten = [name for name in known if name != PAPERS[0] and _is_lower(results, reference, PAPERS[0], name)]
    return ReportFinding(
        "The MPC has the lowest MAE of the three, RL a little higher, the LLMs range widely.",
        _verdict(len(beaten), len(known) - 1),
        ", ".join(f"{name} {mean:.2f} K" for name, mean in known.items())
        + ". Solved as an integer problem instead of rounded, MPC has "
        f"{_text(results, 'MPC', reference, 'mae_true')} K.",
    )


def _undecided(results: Results, reference: str) -> ReportFinding | None:
    left_out = ("clairvoyant", "rules", *SPARING)
    ran = {one.entry for one in results if not one.entry.startswith(left_out)}
    names = sorted(name for name in ran if not name.endswith(VARIANTS))
    means = [mean for name in names if (mean := _mean(results, name, reference, "mae_true")) is not None]
    if len(means) < 2:
        return None
    apart = [abs(a - b) > SENSOR_K for i, a in enumerate(means) for b in means[i + 1 :]]
    return ReportFinding(
        "Within the sensor's ±0.5 °C it is difficult to claim any controller superior.",
        _verdict(len(apart) - sum(apart), len(apart)),
        f"{len(apart) - sum(apart)} of {len(apart)} pairs of controllers are closer than {SENSOR_K:g} K in "
        "MAE. In the simulated box the true air is known, so they can be told apart all the same.",
    )


def _mpc_toggles(results: Results, reference: str) -> ReportFinding | None:
    switches = {name: _mean(results, name, reference, "switches") for name in (PAPERS[0], f"{PAPERS[0]}-P")}
    if None in switches.values():
        return None
    free, spared = (float(value or 0.0) for value in switches.values())
    return ReportFinding(
        "Without penalty the MPC toggles heater and fan frequently and tracks the reference very closely.",
        _verdict(
            int(free > 2.0 * spared) + int((_mean(results, PAPERS[0], reference, "mae_true") or 9) < 0.5), 2
        ),
        f"{free:.0f} switches of the fan's relay without, {spared:.0f} with penalty; true MAE "
        f"{_text(results, PAPERS[0], reference, 'mae_true')} K.",
    )


def _rl_fan_always_on(results: Results, reference: str) -> ReportFinding | None:
    fan = _mean(results, "RL-Off", reference, "fan_min")
    if fan is None:
        return None
    spared = _mean(results, "RL-Off-P", reference, "fan_min")
    beside = "" if spared is None else f"; with penalty {spared:.0f}"
    return ReportFinding(
        "Without penalty the RL keeps the fan ON most of the time, and the heater with it.",
        _verdict(int(fan > 0.5 * _length_min(results, reference)), 1),
        f"{fan:.0f} minutes of fan on {reference}{beside}.",
    )


def _penalty_spares(results: Results, reference: str) -> ReportFinding | None:
    efforts = {}
    for name in ("MPC-BFGS", "MPC", "RL-Off", "LLM-Te0"):
        pair = [_effort(results, each, reference) for each in (name, f"{name}-P")]
        if None not in pair:
            efforts[name] = pair
    if not efforts:
        return None
    less = [name for name in efforts if _spares(results, name, reference)]
    listed = ", ".join(f"{name} {free:.0f} to {spared:.0f}" for name, (free, spared) in efforts.items())
    return ReportFinding(
        "A penalty makes actuation sparser, in all controllers.",
        _verdict(len(less), len(efforts)),
        f"Effort (sum of duty² and fan) without and with it: {listed}.",
    )


def _mpc_same_with_penalty(results: Results, reference: str) -> ReportFinding | None:
    return _with_penalty(
        results, reference, PAPERS[0],
        "With penalty the MPC tracks as well with less actuation (text); it struggles, as the heater is "
        "penalised (caption).",
        "; solved as an integer problem instead of rounded, MPC {0} and MPC-P {1} K",
    )  # fmt: skip


def _rl_worse_with_penalty(results: Results, reference: str) -> ReportFinding | None:
    pair = [_mean(results, name, reference, "mae_true") for name in ("RL-Off", "RL-Off-P")]
    if None in pair:
        return None
    free, spared = (float(value or 0.0) for value in pair)
    return ReportFinding(
        "With penalty the RL tracks noticeably worse.",
        _verdict(int(spared > free + SAME_K), 1),
        f"True MAE {free:.2f} K without, {spared:.2f} K with it.",
    )


def _llm_same_with_penalty(results: Results, reference: str) -> ReportFinding | None:
    return _with_penalty(
        results, reference, "LLM-Te0",
        "With penalty the LLM uses the actuators less without tracking worse.",
        " (a scripted stand-in, not a language model)",
    )  # fmt: skip


def _with_penalty(results: Results, reference: str, name: str, paper: str, more: str) -> ReportFinding | None:
    pair = [_mean(results, each, reference, "mae_true") for each in (name, f"{name}-P")]
    if None in pair:
        return None
    free, spared = (float(value or 0.0) for value in pair)
    efforts = [_effort(results, each, reference) or 0.0 for each in (name, f"{name}-P")]
    exact = [_text(results, each, reference, "mae_true") for each in ("MPC", "MPC-P")]
    return ReportFinding(
        paper,
        _verdict(int(spared < free + SAME_K) + int(_spares(results, name, reference)), 2),
        f"True MAE {free:.2f} K without, {spared:.2f} K with it, effort {efforts[0]:.1f} and {efforts[1]:.1f}"
        f"{more.format(*exact)}.",
    )


def _rl_trains_longest(results: Results, reference: str) -> ReportFinding | None:
    if _mean(results, "RL-Off", reference, "mae_true") is None:
        return None
    known = {f.name: (training_s(f), lines(f.files)) for f in FAMILIES if f.name in ("MPC", "RL", "LLM")}
    longest = max(known, key=lambda name: known[name][0])
    most = max(known, key=lambda name: known[name][1])
    listed = ", ".join(
        f"{name} {seconds:.0f} s and {count} lines" for name, (seconds, count) in known.items()
    )
    return ReportFinding(
        "RL needs the most training and effort, MPC expertise and no training, the LLM neither.",
        _verdict(int(longest == "RL") + int(most == "RL"), 2),
        f"{listed}.",
    )


def _mean(results: Results, name: str, reference: str, figure: str) -> float | None:
    values = column(results, name, reference, figure)
    return float(np.mean(values)) if values else None


def _effort(results: Results, name: str, reference: str) -> float | None:
    efforts = _efforts(results, name, reference)
    return float(np.mean(efforts)) if efforts else None


def _is_lower(results: Results, reference: str, name: str, other: str, figure: str = "mae_true") -> bool:
    """True where the seeds' 95 % interval of the difference lies below 0: equal controllers are not lower."""
    mine, theirs = paired(results, name, other, reference, (figure, figure))
    found = difference(mine, theirs) if mine else None
    return found is not None and found.sure and found.value < 0.0


def _spares(results: Results, name: str, reference: str) -> bool:
    """True where the penalty saves LESS_EFFORT and more than the seeds' spread."""
    free, spared = (_efforts(results, each, reference) for each in (name, f"{name}-P"))
    if not free or len(free) != len(spared):
        return False
    found = difference(spared, free)
    return found.sure and found.value < -LESS_EFFORT * float(np.mean(free))


def _efforts(results: Results, name: str, reference: str) -> list[float]:
    """By seed: cost with weight 1 less that with weight 0."""
    costs = [column(results, name, reference, figure) for figure in ("cost_1", "cost_0")]
    return [one - other for one, other in zip(*costs, strict=True)]


def _text(results: Results, name: str, reference: str, figure: str) -> str:
    value = _mean(results, name, reference, figure)
    return "-" if value is None else f"{value:.2f}"


def _length_min(results: Results, reference: str) -> float:
    return read_profile(FOLDER / f"{reference}.csv").end_s / 60.0


def _verdict(count: int, of: int) -> Verdict:
    if count == 0:
        return "does not hold"
    return "holds" if count == of else "holds in part"
