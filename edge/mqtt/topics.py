"""Every topic of one rig."""

from dataclasses import dataclass

from edge.config.settings import MqttSettings


@dataclass(frozen=True, slots=True)
class Topics:
    """All under `root`, but for the two that Home Assistant prescribes."""

    root: str  # <prefix>/<rig>
    discovery: str  # Home Assistant's device discovery, retained
    home_assistant_status: str  # "online" when Home Assistant has started

    @classmethod
    def of(cls, settings: MqttSettings) -> "Topics":
        """Return the topics that the settings give."""
        return cls(
            root=f"{settings.topic_prefix}/{settings.rig}",
            discovery=f"{settings.discovery_prefix}/device/{settings.rig}/config",
            home_assistant_status=f"{settings.discovery_prefix}/status",
        )

    @property
    def availability(self) -> str:
        """`online` or `offline`, retained; `offline` is the last will."""
        return f"{self.root}/availability"

    @property
    def state(self) -> str:
        """The present state: one flat JSON object, retained."""
        return f"{self.root}/state"

    @property
    def forecast(self) -> str:
        """Air temperature that the controller expects after each of the next steps, retained."""
        return f"{self.root}/forecast"

    @property
    def forecasts(self) -> str:
        """Each predictor's forecast at each horizon, with its interval; retained."""
        return f"{self.root}/forecasts"

    @property
    def skill(self) -> str:
        """How well each predictor does at each horizon, retained."""
        return f"{self.root}/skill"

    @property
    def drift(self) -> str:
        """The agreement of the running twin with the greenhouse, the begin of a
        drift and its place; retained.
        """
        return f"{self.root}/drift"

    @property
    def commissioning(self) -> str:
        """How far commissioning is, `phase` and `text`; retained."""
        return f"{self.root}/commissioning"

    @property
    def twin(self) -> str:
        """The twin of the active bundle, retained; nothing where that is the packaged one."""
        return f"{self.root}/twin"

    @property
    def retained(self) -> tuple[str, ...]:
        """All that stays at the broker until it is taken away."""
        live = (self.state, self.decision, self.forecast, self.forecasts, self.skill, self.drift)
        return (self.discovery, self.availability, *live, self.commissioning, self.twin)

    @property
    def decision(self) -> str:
        """The wanted command, the sent one, and the reason; retained."""
        return f"{self.root}/decision"

    @property
    def event(self) -> str:
        """One message per event."""
        return f"{self.root}/event"

    @property
    def proposal(self) -> str:
        """An operator's request at each of its stages, and the newest one again at each connection."""
        return f"{self.root}/proposal"

    @property
    def reply(self) -> str:
        """Answer to each command."""
        return f"{self.root}/reply"

    def command(self, what: str) -> str:
        """Return the topic on which the command `what` is received; "+" for all."""
        return f"{self.root}/set/{what}"
