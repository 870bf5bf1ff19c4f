"""Every setting of the daemon: default, unit, range and meaning. `loading.py` fills them from YAML."""

from dataclasses import dataclass, field
from datetime import time
from itertools import pairwise
from pathlib import Path

from edge.config.alarm_settings import AlarmSettings
from edge.core import hard_limits as hard
from edge.core.controller_names import AUTO, CONTROLLERS, EXTERNAL, LLM, MPC, RL, RULES
from edge.formats.address import host_problem, url_problem
from edge.formats.cross_check import Section, clock, flag, items, number, text, whole

NAME = r"[a-zA-Z0-9_-]{1,64}"  # fit for MQTT topics and Home Assistant ids
PREDICTORS = ("arx", "pbm", "lstm", "ham")
FALLBACKS = (RULES, *MPC)  # nothing that asks somebody else


@dataclass(frozen=True, slots=True)
class BoardSettings(Section):
    """Serial line to the board."""

    port: str = text("/dev/greenhouse", "serial port; the udev rule makes this stable name")
    baudrate: int = whole(115200, "line speed", 9600, 921600, (9600, 57600, 115200, 230400, 460800, 921600))


@dataclass(frozen=True, slots=True)
class ControlSocketSettings(Section):
    """The command line's way into the running daemon."""

    path: str = text(
        "/run/greenhouse/control.sock", "Unix socket; its file permissions are the access control"
    )


@dataclass(frozen=True, slots=True)
class PageSettings(Section):
    """The web page, a process of its own: `greenhouse page`."""

    port: int = whole(8420, "TCP port", 1, 65535)
    host: str = text(
        "",
        "address to listen at; empty: this machine, and all after `greenhouse page pair`",
        form=host_problem,
    )
    names: tuple[str, ...] = items(
        "further names by which browsers reach it, such as a proxy's; its address and this machine's name do",
        "greenhouse.example.org",
        host_problem,
    )
    proxies: tuple[str, ...] = items(
        "addresses of proxies before it, which name the browser's address in X-Forwarded-For", "127.0.0.1"
    )
    folder: str = text("/var/lib/greenhouse-page", "who may do what lives here")
    certificate: str = text("", "certificate for https, PEM; empty: http")
    key_file: str = text("", "its key, PEM")

    def cross_check(self) -> None:
        """Check that a certificate has its key."""
        if bool(self.certificate) != bool(self.key_file):
            self.refuse("key_file", "certificate and key_file go together")


@dataclass(frozen=True, slots=True)
class HistorySettings(Section):
    """SQLite history."""

    path: str = text("/var/lib/greenhouse/history.db", "database file")
    retention_days: float = number(365.0, "older rows are deleted", "days", 1.0, 36500.0)
    downsample_after_days: float = number(30.0, "older ticks are thinned to 10 minutes", "days", 1.0, 36500.0)
    queue_ticks: int = whole(
        2000, "ticks that may wait for a slow disk; more are dropped and counted", 10, 100000
    )

    @property
    def evidence(self) -> Path:
        """Folder of the sealed record, beside the database."""
        return Path(self.path).parent / "evidence"

    def cross_check(self) -> None:
        """Rows are thinned before they are deleted."""
        if self.downsample_after_days > self.retention_days:
            self.refuse("downsample_after_days", f"is more than retention_days, {self.retention_days:g}")


@dataclass(frozen=True, slots=True)
class MqttSettings(Section):
    """Telemetry and remote commands."""

    enabled: bool = flag(False, "connect to a broker")
    host: str = text("localhost", "broker", pattern=".+", form=host_problem)
    port: int = whole(1883, "broker's port (8883 with TLS)", 1, 65535)
    keepalive_s: int = whole(30, "MQTT keep-alive [s]", 5, 3600)
    tls: bool = flag(False, "encrypt, and check the broker's certificate")
    ca: str = text("", "file of the authority that signed the broker's certificate; empty: the system's")
    client_cert: str = text("", "client certificate file; empty: none")
    client_key: str = text("", "key of the client certificate")
    username: str = text("", "user; empty: none")
    password_file: str = text("", "file that holds the password; a bare name is a systemd credential")
    topic_prefix: str = text("greenhouse", "first level of every topic", pattern=NAME)
    rig: str = text("greenhouse-1", "name of this rig: second level of every topic, client id", pattern=NAME)
    discovery_prefix: str = text("homeassistant", "Home Assistant's discovery topic", pattern=NAME)

    def cross_check(self) -> None:
        """Certificates need TLS, a password needs a user."""
        if (self.ca or self.client_cert) and not self.tls:
            self.refuse("tls", "must be true when ca or client_cert is given")
        if bool(self.client_cert) != bool(self.client_key):
            self.refuse("client_key", "client_cert and client_key go together")
        if self.password_file and not self.username:
            self.refuse("username", "is empty but password_file is given")


@dataclass(frozen=True, slots=True)
class ControlSettings(Section):
    """The loop and its controller."""

    step_s: float = number(60.0, "control step", "s", hard.STEP_MIN_S, hard.STEP_MAX_S, hard=True)
    controller: str = text(
        AUTO,
        "controller at the first start; auto: MPC-Twin-P where the active bundle was installed and has a "
        "twin, else MPC-P",
        (*CONTROLLERS, AUTO),
    )
    fallback: str = text("MPC", "decides when the chosen one fails; when it fails too, rules", FALLBACKS)
    horizon: int = whole(10, "steps an MPC looks ahead", 1, 60)
    tail: int = whole(
        10, "steps after the horizon that MPC and MPC-P count too, fan still, heater as it would hold", 0, 60
    )
    penalty_weight: float = number(
        1.0,
        "of effort (duty squared and fan) against 10 times the error squared, in an MPC named -P",
        "1",
        0.0,
        1e6,
    )
    node_budget: int = whole(
        20_000, "nodes an MPC may search; the same log gives the same decisions", 1, 10_000_000
    )
    time_box_ms: float = number(
        250.0,
        "CPU time that guards the search; the wall time is limited to three times as much",
        "ms",
        1.0,
        60_000.0,
    )
    preview: bool = flag(False, "MPC, MPC-P, MPC-BFGS, MPC-BFGS-P and LLM-* know the coming reference")
    twin_preview: bool = flag(True, "MPC-Twin and MPC-Twin-P know the coming reference")
    twin_early_k: float = number(
        0.3, "they let the air leave the reference by no more before a step of it is due", "K", 0.0, 20.0
    )
    decision_deadline_s: float = number(
        4.0, "a later decision is replaced by the fallback's; never more than half a step", "s", 0.05, 4.0
    )
    predictor: str = text(
        "arx", "model of the active bundle that estimates and that MPC and MPC-P plan with", PREDICTORS
    )
    rollout_budget: int = whole(400, "plans an MPC over another model than the ARX may try", 1, 10_000_000)
    model: str = text("", "ARX model file instead of a bundle's model; empty: none")
    ambient_default_c: float = number(21.0, "room temperature where no sensor tells", "degC", -20.0, 60.0)

    def effort_weight(self, controller: str) -> float:
        """Return what a planning controller pays for effort in addition to the tracking cost."""
        return self.penalty_weight if controller.endswith("-P") else 0.0


@dataclass(frozen=True, slots=True)
class LlmSettings(Section):
    """A language model behind an OpenAI-compatible endpoint."""

    url: str = text("", "base URL, e.g. http://localhost:11434/v1; empty: none", form=url_problem)
    model: str = text("", "its name there")
    key_file: str = text("", "file that holds the API key; a bare name is a systemd credential; empty: none")
    ca: str = text("", "authority of an https server's certificate, PEM; empty: those that are widely known")
    timeout_s: float = number(20.0, "for one exchange", "s", 0.1, 600.0)
    retries: int = whole(2, "of an exchange that failed by 429, 5xx or the line", 0, 10)
    backoff_s: float = number(1.0, "pause before the first retry, doubled for each more", "s", 0.0, 60.0)
    exchanges: int = whole(8, "exchanges for one answer, those with tools among them", 1, 50)
    answer_tokens: int = whole(800, "longest answer of one exchange [tokens]", 16, 100_000)
    answer_age_max_s: float = number(
        90.0, "a command is taken from an answer to a question no older than this", "s", 1.0, 3600.0
    )
    memory_tokens: int = whole(
        800, "facts of `greenhouse memory` put beside a request in words, at most [tokens]; 0: none", 0, 8000
    )
    tokens_per_day: int = whole(10_000_000, "budget of a UTC day [tokens]; 0: none is set", 0, 10**12)
    cost_per_day: float = number(
        0.0, "budget of a UTC day, in the prices' currency; 0: none is set", "1", 0.0, 1e6
    )
    price_in: float = number(0.0, "of a million tokens sent", "1", 0.0, 1e6)
    price_out: float = number(0.0, "of a million tokens received", "1", 0.0, 1e6)

    def cross_check(self) -> None:
        """Check that an endpoint has a model's name and a cost budget has prices."""
        if "?" in self.url:
            self.refuse("url", "has a part behind a question mark: a base URL has none")
        if self.url and not self.model:
            self.refuse("model", "is empty but url is given")
        if self.cost_per_day and not (self.price_in or self.price_out):
            self.refuse("cost_per_day", "needs price_in and price_out")


@dataclass(frozen=True, slots=True)
class ExternalSettings(Section):
    """A process of its own that decides: the controller `external`."""

    socket: str = text("", "Unix socket on which it is asked; empty: there is none")


@dataclass(frozen=True, slots=True)
class BundleSettings(Section):
    """Signed bundles of predictive models."""

    path: str = text("/var/lib/greenhouse/bundles", "folder of the installed bundles; empty: none are used")
    trusted_keys: str = text(
        "/etc/greenhouse/keys",
        "folder of public keys (*.pub) whose bundles may be installed, beside the packaged one",
    )
    signing_key: str = text(
        "",
        "private key that signs twins which this rig adopts (`greenhouse bundle key`); empty: --key says it",
    )
    auto: str = text(
        "off",
        "off: the scores are shown, a person activates; promote: a shadow that is better is activated, "
        "and rolled back where it turns out worse",
        ("off", "promote"),
    )
    source: str = text(
        "",
        "address under which a fleet's bundles stand: orders over MQTT install from there what a trusted key "
        "has signed; empty: such orders are refused",
        form=url_problem,
    )
    source_ca: str = text(
        "", "certificate of the authority by which `source` is known over https; empty: this system's"
    )
    trial_ticks: int = whole(
        1440,
        "forecasts scored at each horizon before a bundle in shadow or on probation is judged",
        10,
        1_000_000,
    )


@dataclass(frozen=True, slots=True)
class DriftSettings(Section):
    """Does the running twin still agree with the box; at night, what is missing in it."""

    enabled: bool = flag(True, "test the active bundle's twin at each tick")
    false_alarm_days: float = number(90.0, "mean time to a false alarm, at least", "days", 1.0, 3650.0)
    learn_h: float = number(
        24.0,
        "time with the heater on or off and the fan on or off, each, from which the twin's ordinary errors "
        "are learnt; gross disagreement is told before",
        "h",
        1.0,
        1000.0,
    )
    diagnose: str = text(
        "never", "when `greenhouse twin diagnose` runs at night", ("never", "disagrees", "always")
    )
    diagnose_at: time = clock("03:00", "begin of the diagnosis")  # noqa: RUF009
    diagnose_since_d: float = number(14.0, "history that it reads", "days", 0.1, 365.0)
    diagnose_max_min: float = number(120.0, "a diagnosis that takes longer is ended", "min", 1.0, 720.0)
    reports: str = text("/var/lib/greenhouse/diagnosis", "folder of its reports")
    adopt: str = text(
        "shadow",
        "what becomes of a twin that it finds: never: it stays in the report; shadow: it runs beside the "
        "active bundle and is scored; activate: it takes its place, on probation",
        ("never", "shadow", "activate"),
    )


@dataclass(frozen=True, slots=True)
class ReferenceStep(Section):
    """From `at_s` after the first start with these steps on, over restarts: `reference_c`."""

    at_s: float = number(0.0, "time since the first start with these steps", "s", 0.0, 1e9)
    reference_c: float = number(24.0, "target", "degC", hard.REFERENCE_MIN_C, hard.REFERENCE_MAX_C, hard=True)


@dataclass(frozen=True, slots=True)
class DailyReference(Section):
    """From local time `at` on, every day: `reference_c`."""

    at: time = clock("00:00", "time of day")  # noqa: RUF009
    reference_c: float = number(24.0, "target", "degC", hard.REFERENCE_MIN_C, hard.REFERENCE_MAX_C, hard=True)


@dataclass(frozen=True, slots=True)
class RampReference(Section):
    """From `from_c` to `to_c`, linear."""

    from_c: float = number(
        22.0, "target before", "degC", hard.REFERENCE_MIN_C, hard.REFERENCE_MAX_C, hard=True
    )
    to_c: float = number(28.0, "target after", "degC", hard.REFERENCE_MIN_C, hard.REFERENCE_MAX_C, hard=True)
    start_s: float = number(0.0, "begins so long after the first start with this ramp", "s", 0.0, 1e9)
    duration_s: float = number(3600.0, "takes so long", "s", 1.0, 1e9)


@dataclass(frozen=True, slots=True)
class ReferenceSettings(Section):
    """Target of the air temperature over time."""

    kind: str = text(
        "constant", "which of the keys below is used", ("constant", "steps", "daily", "ramp", "csv")
    )
    min_c: float = number(
        15.0, "an operator can ask for no less", "degC", hard.REFERENCE_MIN_C, hard.REFERENCE_MAX_C, hard=True
    )
    max_c: float = number(
        38.0, "an operator can ask for no more", "degC", hard.REFERENCE_MIN_C, hard.REFERENCE_MAX_C, hard=True
    )
    reference_c: float = number(
        24.0, "constant", "degC", hard.REFERENCE_MIN_C, hard.REFERENCE_MAX_C, hard=True
    )
    steps: tuple[ReferenceStep, ...] = items("steps: holds until the next", "{at_s: 0, reference_c: 24}")
    daily: tuple[DailyReference, ...] = items(
        "daily: the last one of the day holds over midnight", '{at: "06:00", reference_c: 26}'
    )
    ramp: RampReference = field(default_factory=RampReference)
    csv: str = text("", "csv: a profile with the columns time_s and reference_c")

    def cross_check(self) -> None:
        """Check that the chosen kind has its keys, in order, inside min_c..max_c."""
        if not self.min_c < self.max_c:
            self.refuse("min_c", f"must be below max_c, {self.max_c:g}")
        for key, value in self._targets():
            if not self.min_c <= value <= self.max_c:
                self.refuse(key, f"{value:g} is outside min_c..max_c, {self.min_c:g}..{self.max_c:g}")
        if self.kind in ("steps", "daily", "csv") and not getattr(self, self.kind):
            self.refuse(self.kind, f"is empty but kind is {self.kind}")
        if any(not a.at_s < b.at_s for a, b in pairwise(self.steps)):
            self.refuse("steps", "at_s must rise from one to the next")
        if any(not a.at < b.at for a, b in pairwise(self.daily)):
            self.refuse("daily", "times must rise from one to the next, each once")

    def _targets(self) -> list[tuple[str, float]]:
        listed = [(f"steps[{i}].reference_c", s.reference_c) for i, s in enumerate(self.steps)]
        listed += [(f"daily[{i}].reference_c", d.reference_c) for i, d in enumerate(self.daily)]
        ramp = (
            [("ramp.from_c", self.ramp.from_c), ("ramp.to_c", self.ramp.to_c)] if self.kind == "ramp" else []
        )
        constant = [("reference_c", self.reference_c)] if self.kind == "constant" else []
        return constant + listed + ramp


@dataclass(frozen=True, slots=True)
class EstimatorSettings(Section):
    """Kalman filter on the air temperature."""

    measurement_sd_k: float = number(0.1, "noise of one measurement", "K", 0.001, 5.0)
    process_sd_k: float = number(
        0.05, "what a model misses in a minute, by chance", "K per sqrt(min)", 0.0001, 5.0
    )
    offset_sd_k: float = number(
        0.01, "how fast the disturbance wanders: change of K per minute, in a minute", "K", 0.000001, 1.0
    )


@dataclass(frozen=True, slots=True)
class SensorHealthSettings(Section):
    """When a reading is no measurement."""

    sample_period_s: float = number(
        1.0, "the board's report period; three periods without a sample are stale", "s", 0.1, 10.0
    )
    air_jump_k: float = number(
        2.0, "a temperature this far from the last one is a spike until it is confirmed", "K", 0.3, 20.0
    )
    stuck_after_s: float = number(
        600.0,
        "an air temperature exactly the same so long, though the heat must have moved it, is stuck; "
        "twice so long under full heat",
        "s",
        120.0,
        86400.0,
    )


@dataclass(frozen=True, slots=True)
class SensorCalibration(Section):
    """measurement = gain * reading + offset."""

    offset: float = number(0.0, "added, in the signal's unit", "unit of signal", -1000.0, 1000.0)
    gain: float = number(1.0, "multiplied first", "1", 0.5, 2.0)


@dataclass(frozen=True, slots=True)
class CalibrationSettings(Section):
    """Correction per sensor: measurement = gain * reading + offset."""

    temp_air: SensorCalibration = field(default_factory=SensorCalibration)
    temp_ambient: SensorCalibration = field(default_factory=SensorCalibration)
    rel_humidity: SensorCalibration = field(default_factory=SensorCalibration)
    co2: SensorCalibration = field(default_factory=SensorCalibration)
    light: SensorCalibration = field(default_factory=SensorCalibration)
    soil_moisture: SensorCalibration = field(default_factory=SensorCalibration)
    tank_level: SensorCalibration = field(default_factory=SensorCalibration)

    def cross_check(self) -> None:
        """Refuse a calibration of the air temperature that would defeat every temperature limit."""
        air = self.temp_air
        if not abs(air.offset) <= hard.AIR_OFFSET_MAX_K:
            self.refuse(
                "temp_air.offset", f"{air.offset:g} is beyond the hard limit ±{hard.AIR_OFFSET_MAX_K:g}"
            )
        if not hard.AIR_GAIN_MIN <= air.gain <= hard.AIR_GAIN_MAX:
            self.refuse(
                "temp_air.gain",
                f"{air.gain:g} is beyond the hard limits {hard.AIR_GAIN_MIN:g} and {hard.AIR_GAIN_MAX:g}",
            )


@dataclass(frozen=True, slots=True)
class SafetySettings(Section):
    """Limits in front of every writer."""

    temp_air_max_c: float = number(
        40.0, "at or above: heater off, fan on", "degC", 10.0, hard.TEMP_AIR_MAX_C, hard=True
    )
    temp_trip_c: float = number(
        43.0, "at or above: the same, latched until reset", "degC", 12.0, hard.TEMP_TRIP_MAX_C, hard=True
    )
    reading_age_max_s: float = number(
        10.0, "an older air temperature allows no heating", "s", 1.0, hard.READING_AGE_MAX_S, hard=True
    )
    heater_max_duty: float = number(1.0, "largest heater duty", "1", 0.0, 1.0, hard=True)
    heater_rise_per_s: float = number(
        0.05,
        "fastest rise of the heater duty; falls are free",
        "1/s",
        0.001,
        hard.HEATER_RISE_MAX_PER_S,
        hard=True,
    )
    fan_min_on_s: float = number(5.0, "the fan's relay stays on at least so long", "s", 0.0, 3600.0)
    fan_min_off_s: float = number(5.0, "and off so long, unless safety needs the fan", "s", 0.0, 3600.0)
    fan_switches_hour_max: int = number(60, "switches of the fan's relay in an hour", "1", 2, 720, hard=True)
    energy_hour_max_wh: float = number(
        100.0, "heat in the last hour", "Wh", 1.0, hard.HEAT_HOUR_MAX_WH, hard=True
    )
    energy_day_max_wh: float = number(
        2000.0, "heat in the last 24 hours", "Wh", 1.0, hard.HEAT_DAY_MAX_WH, hard=True
    )
    led_max: float = number(1.0, "largest LED level", "1", 0.0, 1.0, hard=True)
    valve_pulse_max_s: float = number(
        5.0, "longest single pulse", "s", 0.0, hard.VALVE_PULSE_MAX_S, hard=True
    )
    valve_day_max_s: float = number(
        60.0, "valve open in the last 24 hours", "s", 0.0, hard.VALVE_DAY_MAX_S, hard=True
    )
    tank_level_min: float = number(0.1, "below or unknown: no water", "1", 0.0, 1.0)
    soil_moisture_max: float = number(0.8, "at, above or unknown: no water", "1", 0.05, 1.0)

    def cross_check(self) -> None:
        """Check that the latch lies above the plain limit."""
        if not self.temp_air_max_c < self.temp_trip_c:
            self.refuse("temp_trip_c", f"must be above temp_air_max_c, {self.temp_air_max_c:g}")


@dataclass(frozen=True, slots=True)
class BoxSettings(Section):
    """The greenhouse itself."""

    twin: str = text(
        "",
        "twin file of this box, from which safety takes its bounds; empty: the paper's 0.15 m3 and heater_w",
    )
    heater_w: float = number(
        0.0,
        "power of the heater at full duty; 0: that of the twin file, and no heat without one",
        "W",
        0.0,
        1e4,
    )


@dataclass(frozen=True, slots=True)
class LightingSettings(Section):
    """LED photoperiod."""

    enabled: bool = flag(False, "drive the LED by the clock")
    on: time = clock("06:00", "light begins")  # noqa: RUF009
    off: time = clock("22:00", "light ends; before `on`: over midnight")  # noqa: RUF009
    level: float = number(1.0, "LED level while on", "1", 0.0, 1.0)

    def cross_check(self) -> None:
        """Refuse a photoperiod of nothing or of a whole day."""
        if self.on == self.off:
            self.refuse("off", "is the same time as on")


@dataclass(frozen=True, slots=True)
class WateringSettings(Section):
    """Soil-moisture watering."""

    enabled: bool = flag(False, "water by soil moisture")
    threshold: float = number(0.3, "soil moisture below which a pulse is given", "1", 0.0, 1.0)
    pulse_s: float = number(2.0, "valve open per pulse", "s", 0.1, hard.VALVE_PULSE_MAX_S, hard=True)
    soak_s: float = number(600.0, "pause after a pulse, for the water to arrive", "s", 60.0, 86400.0)
    daily_max_s: float = number(30.0, "valve open in 24 hours", "s", 0.0, hard.VALVE_DAY_MAX_S, hard=True)


@dataclass(frozen=True, slots=True)
class Settings(Section):
    """All of edge.yaml."""

    state_file: str = text(
        "/var/lib/greenhouse/state.json", "mode, emergency stop and latched trips live here over a restart"
    )
    timezone: str = text("local", 'for daily references and lighting: "local" or a name like "Europe/Oslo"')
    board: BoardSettings = field(default_factory=BoardSettings)
    control_socket: ControlSocketSettings = field(default_factory=ControlSocketSettings)
    page: PageSettings = field(default_factory=PageSettings)
    alarms: AlarmSettings = field(default_factory=AlarmSettings)
    history: HistorySettings = field(default_factory=HistorySettings)
    mqtt: MqttSettings = field(default_factory=MqttSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    llm: LlmSettings = field(default_factory=LlmSettings)
    external: ExternalSettings = field(default_factory=ExternalSettings)
    bundle: BundleSettings = field(default_factory=BundleSettings)
    drift: DriftSettings = field(default_factory=DriftSettings)
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    sensor_health: SensorHealthSettings = field(default_factory=SensorHealthSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    safety: SafetySettings = field(default_factory=SafetySettings)
    box: BoxSettings = field(default_factory=BoxSettings)
    lighting: LightingSettings = field(default_factory=LightingSettings)
    watering: WateringSettings = field(default_factory=WateringSettings)

    def cross_check(self) -> None:
        """Check the conditions between sections."""
        if not self.reference.max_c < self.safety.temp_air_max_c:
            self.refuse(
                "reference.max_c", f"must be below safety.temp_air_max_c, {self.safety.temp_air_max_c:g}"
            )
        if self.watering.pulse_s > self.safety.valve_pulse_max_s:
            self.refuse(
                "watering.pulse_s",
                f"is more than safety.valve_pulse_max_s, {self.safety.valve_pulse_max_s:g}",
            )
        if reason := self.unready(self.control.controller):
            self.refuse("control.controller", reason)
        if self.timezone != "local" and not _known_zone(self.timezone):
            self.refuse("timezone", f'{self.timezone!r} is neither "local" nor a zone of this machine')

    @property
    def stop_folder(self) -> Path:
        """The folder of a stop that waits for a daemon, see `edge.sockets.stop_file`."""
        return Path(self.state_file).parent / "stops"

    def unready(self, controller: str) -> str:
        """Why this rig cannot have a controller, "" where it can."""
        if controller in LLM and not self.llm.url:
            return f"{controller} needs llm.url and llm.model"
        if controller == EXTERNAL and not self.external.socket:
            return f"{controller} needs external.socket"
        if controller in RL and not self.bundle.path:
            return f"{controller} needs bundle.path and a bundle with its policy"
        return ""

    @property
    def controllers(self) -> tuple[str, ...]:
        """Those that this rig can have."""
        return tuple(name for name in CONTROLLERS if not self.unready(name))


def _known_zone(name: str) -> bool:
    from zoneinfo import ZoneInfo  # late: its database is read only where a zone is named

    try:
        ZoneInfo(name)
    except (OSError, ValueError, KeyError):  # no such file, no such name
        return False
    return True
