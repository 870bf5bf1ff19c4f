"""DarkGreyBox 0.3.2 (Zagoni 2022) on the rows that the yardstick gets, in a process with a pandas before 3.

    python dark_grey.py FOLDER

Its models Ti, TiTe, TiTh and TiTeTh by `lmfit` (least squares from several starts), with bounds in units of
the box's own response, each run with starts of its own and, where nobody measured it, a room of its own: what
its authors leave to the user. The simplest within 5 % of the best error over the training rows is chosen.
"""

import csv
import sys
from pathlib import Path

import lmfit
import numpy as np
from darkgreybox import models
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FEWER = ("Ti", "TiTh", "TiTe", "TiTeTh")  # simplest first
NEARLY = 1.05
STARTS = (
    (0.3, 0.05),
    (0.3, 0.3),
    (0.1, 0.02),
)  # time constants of body and heater, as shares of the longest run
MOST_ROWS = 4000  # its Euler steps are loops: more rows are thinned
EVALUATIONS = 4000
WIDE = 1e4


def read(path: Path) -> tuple[dict[str, str], dict[str, Floats]]:
    """Return facts and columns."""
    lines = path.read_text(encoding="utf-8").splitlines()
    facts = dict(line[1:].split(":", 1) for line in lines if line.startswith("#"))
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    table = np.array(rows[1:], dtype=float)
    return {key.strip(): text.strip() for key, text in facts.items()}, dict(
        zip(rows[0], table.T, strict=True)
    )


class Case:
    """Training and test parts of runs, at equal steps."""

    def __init__(self, folder: Path) -> None:
        found = [(path.name, *read(path)) for path in sorted(folder.glob("*.csv"))]
        total = sum(len(columns["time_s"]) for _, _, columns in found)
        self.thin = max(1, total // MOST_ROWS)
        self.rest = any("at_rest" in facts for _, facts, _ in found)
        self.runs: list[dict[str, Floats]] = []
        self.ends: list[int] = []
        self.tests: list[dict[str, Floats]] = []
        for name, facts, columns in found:
            own = {key: values[:: self.thin] for key, values in columns.items()}
            from_s = facts.get("validate_from_s")
            if from_s is not None:
                self.ends.append(int((own["time_s"] < float(from_s)).sum()))
                self.runs.append(own)
            elif name.startswith("train"):
                self.ends.append(len(own["time_s"]))
                self.runs.append(own)
            else:
                self.tests.append(own)
        self.step_h = float(np.median(np.diff(self.runs[0]["time_s"]))) / 3600.0
        self.has_room = all("temp_ambient_c" in own for own in (*self.runs, *self.tests))
        self.span_h = max(len(own["time_s"]) for own in self.runs) * self.step_h


def inputs(case: Case, own: dict[str, Floats], room_c: float) -> dict[str, Floats]:
    """Return the inputs of a model, heat as a duty."""
    room = own["temp_ambient_c"] if case.has_room else np.full(len(own["time_s"]), room_c)
    return {"Ta": room, "Ph": own["heater_duty"]}


def begun(kind: str, case: Case, shares: tuple[float, float]) -> lmfit.Parameters:
    """Return parameters at a start: capacities in units of 1 / gain, as the power may be any."""
    loss, body = 1.0, case.span_h * shares[0]
    values = {"Ci": body if kind == "Ti" else 0.3 * body}
    if "Te" in kind:
        values |= {"Ce": body, "Rie": loss, "Rea": loss}
    else:
        values |= {"Ria": loss}
    if "Th" in kind:
        values |= {"Ch": case.span_h * shares[1], "Rih": 1.0}
    warm = max(float(np.ptp(own["temp_air_c"])) for own in case.runs)
    scale = {"C": 1.0 / warm, "R": warm}
    found = lmfit.Parameters()
    for name, value in values.items():
        usual = value * scale[name[0]]
        low = max(usual / WIDE, (case.step_h / warm) if name[0] == "C" else 0.0)
        found.add(name, value=max(usual, low), min=low, max=usual * WIDE)
    for i, own in enumerate(case.runs):
        first = float(own["temp_air_c"][:3].mean())
        for name in ("Ti", "Te", "Th"):
            if name in kind:
                found.add(f"{name}0_{i}", value=first, min=first - 200.0, max=first + 400.0)
        if not case.has_room:
            found.add(f"room_{i}", value=first if case.rest else min(first - 0.5, 24.0), min=-20.0, max=60.0)
    return found


def follow(kind: str, case: Case, parameters: lmfit.Parameters, i: int, rows: int) -> Floats:
    """Return what a model shows over the first rows of a training run."""
    own = parameters.copy()
    for name in ("Ti", "Te", "Th"):
        if name in kind:
            own.add(f"{name}0", value=parameters[f"{name}0_{i}"].value)
    room = 0.0 if case.has_room else parameters[f"room_{i}"].value
    x = {key: values[:rows] for key, values in inputs(case, case.runs[i], room).items()}
    return np.asarray(getattr(models, kind)(own, case.step_h).model(own, x).Z)


def errors(parameters: lmfit.Parameters, kind: str, case: Case) -> Floats:
    """Return the errors over all training rows."""
    found = [
        follow(kind, case, parameters, i, end) - own["temp_air_c"][:end]
        for i, (own, end) in enumerate(zip(case.runs, case.ends, strict=True))
    ]
    return np.nan_to_num(np.concatenate(found), nan=1e3, posinf=1e3, neginf=-1e3).clip(-1e3, 1e3)


def held_out(kind: str, case: Case, fitted: lmfit.Parameters) -> Floats:
    """Return the errors over rows behind the training parts, or over test runs from their first row."""
    if not case.tests:
        return np.concatenate(
            [
                follow(kind, case, fitted, i, len(own["time_s"]))[end:] - own["temp_air_c"][end:]
                for i, (own, end) in enumerate(zip(case.runs, case.ends, strict=True))
            ]
        )
    found = []
    rooms = [] if case.has_room else [fitted[f"room_{i}"].value for i in range(len(case.runs))]
    for own in case.tests:
        first = float(own["temp_air_c"][:3].mean())
        x = inputs(case, own, first if case.rest or case.has_room else float(np.mean(rooms)))
        room = float(x["Ta"][0])
        given = fitted.copy()
        # In balance: the heater as warm as the air, the envelope between air and room.
        share = given["Rea"].value / (given["Rea"].value + given["Rie"].value) if "Te" in kind else 0.0
        for name, value in (("Ti0", first), ("Te0", room + share * (first - room)), ("Th0", first)):
            given.add(name, value=value)
        found.append(getattr(models, kind)(given, case.step_h).model(given, x).Z - own["temp_air_c"])
    return np.concatenate(found)


def rms(values: Floats) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main(folder: Path) -> None:
    """Fit all models and print the one that is chosen, with its errors."""
    case, fits = Case(folder), {}
    for kind in FEWER:
        tries = [
            lmfit.minimize(errors, begun(kind, case, shares), args=(kind, case), max_nfev=EVALUATIONS)
            for shares in STARTS[: 1 if kind == "Ti" else None]
        ]
        best = min(tries, key=lambda result: result.chisqr)
        fits[kind] = (rms(errors(best.params, kind, case)), best.params)
        print(f"   {kind} {fits[kind][0]:.4g} {rms(held_out(kind, case, best.params)):.4g}")
    least = min(error for error, _ in fits.values())
    kind = next(kind for kind in FEWER if fits[kind][0] <= NEARLY * least)
    error, fitted = fits[kind]
    print(
        f"x: {kind} is the simplest within 5 % of the best over the training rows ({error:.4g} K); "
        f"held out {rms(held_out(kind, case, fitted)):.4g} K"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
