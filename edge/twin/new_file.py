"""A twin file for a box of which little is known: what is measured by hand, and the rest to be fitted."""

from dataclasses import dataclass, replace

from edge.core.errors import RequestError
from edge.twin.effects.library import EFFECTS
from edge.twin.geometry import Geometry
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

FILM_M2_K_W = 0.26  # both faces of a wall in a room, ISO 6946 table 7: twice 0.13
# ISO 10456:2007 table 3; of foams and cardboard what makers usually declare.
CONDUCTIVITY_W_M_K = {
    "plywood": 0.13,
    "wood": 0.13,
    "cardboard": 0.06,
    "glass": 1.0,
    "acrylic": 0.18,
    "polycarbonate": 0.20,
    "polystyrene-foam": 0.035,
    "polyurethane-foam": 0.028,
    "steel": 50.0,
    "aluminium": 160.0,
    "brick": 0.6,
}
VOLUME_M3 = (1e-4, 10.0)  # 0.1 litre to a small room
HEATER_W = (0.1, 20_000.0)
CHANGES_PER_H = 3600.0  # air changes; a fan that does more has been given in another unit
ROOM_ERROR = "ambient_offset"
WALL_REL_SD = 0.3  # of a loss by area and material: edges, seams and floors are not in it


@dataclass(frozen=True, slots=True)
class BoxDescription:
    """A person's facts about the greenhouse. wall : material and thickness [m]; None where not known"""

    volume_m3: float
    heater_w: float
    fan_role: str
    fan_m3_h: float | None = None
    wall_area_m2: float | None = None
    wall: tuple[str, float] | None = None
    sample_s: float = 60.0


def check(box: BoxDescription) -> None:
    """Refuse numbers that look like another unit. Errors: RequestError, which names the option"""
    problems = {
        "--volume": volume_problem(box.volume_m3),
        "--heater-w": heater_problem(box.heater_w),
        "--fan-flow": "",
    }
    if box.fan_role == "exhaust":
        if box.fan_m3_h is None:
            raise RequestError("--fan exhaust: needs --fan-flow, what it moves when it runs free [m3/h]")
        problems["--fan-flow"] = flow_problem(box.fan_m3_h, box.volume_m3)
    for option, problem in problems.items():
        if problem:
            raise RequestError(f"{option}: {problem}")
    if (box.wall is None) != (box.wall_area_m2 is None):
        raise RequestError("--wall and --wall-area go together")


def volume_problem(volume_m3: float) -> str:
    """Why a volume [m3] looks like another unit, "" where it does not."""
    low, high = VOLUME_M3
    if volume_m3 > high:
        return f"{volume_m3:g} m3 is a house: litres? ({volume_m3:g}l)"
    if volume_m3 < low:
        return f"{volume_m3:g} m3 is less than {1000.0 * low:g} litres: m3 or litres?"
    return ""


def heater_problem(heater_w: float) -> str:
    """Why a power [W] looks like another unit, "" where it does not."""
    low, high = HEATER_W
    return "" if low <= heater_w <= high else f"{heater_w:g} W is not within {low:g}..{high:g} W: kW?"


def flow_problem(fan_m3_h: float, volume_m3: float) -> str:
    """Why a flow [m3/h] looks like another unit for this volume [m3], "" where it does not."""
    changes = fan_m3_h / volume_m3
    if not fan_m3_h > 0.0:
        return f"{fan_m3_h:g} m3/h is not above 0; a fan that moves nothing has the role none"
    if changes <= CHANGES_PER_H:
        return ""
    return f"{fan_m3_h:g} m3/h changes the air {changes:.0f} times an hour: l/min?"


def loss_w_k(box: BoxDescription) -> float | None:
    """Through the walls by area, thickness and material, ISO 6946: UA = A / (0.26 + d / lambda)."""
    if box.wall is None or box.wall_area_m2 is None:
        return None
    return box.wall_area_m2 / resistance_m2_k_w(*box.wall)


def resistance_m2_k_w(material: str, thickness_m: float) -> float:
    """Return the resistance of a wall with the films on both faces, ISO 6946 [m2 K/W]."""
    return FILM_M2_K_W + thickness_m / CONDUCTIVITY_W_M_K[material]


def text(box: BoxDescription) -> str:
    """Return the file, with a comment on each line."""
    usual = Geometry()
    flow = usual.fan_max_m3_s if box.fan_m3_h is None else box.fan_m3_h / 3600.0
    loss = loss_w_k(box)
    known = "{fit: true}" if loss is None else f"{{value: {loss:.3g}, rel_sd: {WALL_REL_SD:g}}}"
    source = "fitted to the runs" if loss is None else f"{_wall(box)}, ISO 6946"
    return f"""# A bare number is exact, {{value, rel_sd}} is uncertain, {{fit: true}} is to be fitted.
geometry:
  volume_m3: {box.volume_m3:.6g}  # {1000.0 * box.volume_m3:.4g} litres of air
  heater_max_w: {box.heater_w:.6g}  # at duty 1; if it is not known, what is fitted is in proportion to it
  fan_max_m3_s: {flow:.6g}  # {_flow(box)}
fan_role: {box.fan_role}  # exhaust changes the air, stirring mixes it, none: there is no fan
fan_control: relay  # on or off, 0.3 is on for 0.3 of a step; speed: 0.3 of its flow throughout the step
sample_s: {box.sample_s:g}  # step of the twin [s]; rows of runs at least as close
effects:
  wall_loss:
    UA: {known}  # heat through the walls [W/K]; {source}
  extra_capacity:
    kC: {{fit: true}}  # heat capacity of all that is warmed with the air, in times the air's own
{_fan(box)}sensor: {{quantisation_k: 0.0, noise_sd_k: null}}  # null: found from the runs
nuisance: {{heater_power_run_sd: null, heat_noise_sd_w: null}}
"""


def with_room_error(file: TwinFile, assumed_c: float, true_c: float) -> TwinFile:
    """Return a known twin for a rig that has no room sensor and assumes `assumed_c`.

    true_c : the room that the twin was fitted with, an error of its own not yet taken away

    Errors : DataError where the two are further apart than an error of a sensor can be
    """
    (parameter,) = EFFECTS[ROOM_ERROR].parameters
    own = file.effects.get(ROOM_ERROR, {})
    error_k = assumed_c - true_c + sum(value.value for value in own.values())
    error = {parameter.name: Value(float(f"{error_k:.4g}"))}
    changed = replace(file, effects={**file.effects, ROOM_ERROR: error})
    changed.twin()
    return changed


def _fan(box: BoxDescription) -> str:
    """Return the fan's lines. An exhaust fan never reaches its rated flow, which holds without resistance."""
    if box.fan_role == "none":
        return ""
    if box.fan_role == "stirring":
        return (
            "  stirred_loss:\n    G_stir: {fit: true}  # heat that leaves faster while the fan runs [W/K]\n"
        )
    share = "eps_f: {fit: true}  # share of the fan's free flow that changes air in this box"
    return f"  fan_effectiveness:\n    {share}\n"


def _wall(box: BoxDescription) -> str:
    assert box.wall is not None
    return f"{box.wall_area_m2:g} m2 of {box.wall[0]}, {1000.0 * box.wall[1]:g} mm"


def _flow(box: BoxDescription) -> str:
    if box.fan_role != "exhaust":
        return "plays no part"
    return f"{box.fan_m3_h:g} m3/h when it runs free"
