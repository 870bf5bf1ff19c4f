"""A predefined input profile in a controller's place: open loop, behind the same safety."""

from edge.core.controller import Context
from edge.core.messages import Command, Decision
from edge.formats.profile_file import Profile


class InputProfile:
    """Commands of a profile with `heater_duty, fan_on[, light]`; its time 0 is the first decision.

    A fraction of `fan_on` is the share of each step in which the fan is on.
    """

    name = "profile"

    def __init__(self, profile: Profile) -> None:
        self._profile = profile
        self._start_s: float | None = None

    def reset(self) -> None:
        """Time goes on while another controller stands in."""

    def decide(self, context: Context) -> Decision:
        """Return the present row of the profile, whatever the temperature."""
        if self._start_s is None:
            self._start_s = context.now_s
        # Ticks begin some milliseconds late, rows stand on the grid.
        steps = round((context.now_s - self._start_s) / context.step_s)
        row = self._profile.at(steps * context.step_s)
        fan = row["fan_on"]
        command = Command(row["heater_duty"], fan > 0.0, row.get("light", 0.0), fan_share=fan or 1.0)
        return Decision(command, self.name, why={"profile_time_s": steps * context.step_s})
