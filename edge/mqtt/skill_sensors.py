"""Home Assistant's diagnostics of the predictors: error and skill of each, all the rest as attributes."""

from typing import Any

from edge.mqtt.topics import Topics

Json = dict[str, Any]

PREDICTORS = {"arx": "ARX", "pbm": "PBM", "lstm": "LSTM", "ham": "HAM"}  # one that does not run is unknown
SHOWN_MIN = 15  # about as far as an MPC looks, and no step shorter than 9 s is too short for it


def skill_sensors(topics: Topics) -> dict[str, Json]:
    """Components by key, on the topic of the skill."""
    sensors: dict[str, Json] = {}
    for name, label in PREDICTORS.items():
        row = f"value_json.predictors.get('{name}', {{}}).get('horizons', {{}}).get('{SHOWN_MIN}', {{}})"
        share = f"{row}.get('against_persistence')"
        sensors[f"error_{name}"] = {
            **_diagnostic(topics, name, f"Error of {label} in {SHOWN_MIN} min", 3),
            "value_template": f"{{{{ {row}.get('mae_k') }}}}",
            "unit_of_measurement": "K",
        }
        sensors[f"skill_{name}"] = {
            **_diagnostic(topics, name, f"Skill of {label} in {SHOWN_MIN} min", 0),
            "value_template": f"{{{{ None if {share} is none else ({share} * 100) | round(1) }}}}",
            "unit_of_measurement": "%",
        }
    return sensors


def _diagnostic(topics: Topics, name: str, label: str, digits: int) -> Json:
    return {
        "platform": "sensor",
        "name": label,
        "state_topic": topics.skill,
        "state_class": "measurement",
        "suggested_display_precision": digits,
        "json_attributes_topic": topics.skill,
        "json_attributes_template": f"{{{{ value_json.predictors.get('{name}', {{}}) | tojson }}}}",
        "entity_category": "diagnostic",
    }
