"""Is the heater's relay really off when it is told off? A proof, where ordinary control never shows it.

While heater and fan take turns, a relay that is stuck on gives what is wanted half of the time and the fan
takes the rest away: no energy balance that every healthy box keeps can tell. What can is air that falls
while the heater is told off and the fan is still: with a relay stuck on it rises. Most boxes show that.
Where both have been busy for EVERY_S and it was never seen, heat and fan are held back until it is, or until
the balance of thermal_supervision.py has had its QUIET_S and names the relay. (A proof test in the sense
of IEC 61508-4.)
"""

import math
from dataclasses import dataclass, replace

EVERY_S = 10800.0
BUSY_SHARE = 0.1  # of the time, both of heat and of fan
PASSED_K = 1.0  # more than noise, less than a plant would feel
LONGEST_S = 1500.0  # the fan's relay may have to finish its minimum on time before it is quiet


@dataclass(frozen=True, slots=True)
class RelayProof:
    """The evidence since the relay was last seen off."""

    since_s: float = 0.0
    heated_s: float = 0.0
    fanned_s: float = 0.0
    running_s: float | None = None  # None while no proof is under way
    highest_c: float = -math.inf  # air since the heater was last told off with the fan still

    @property
    def running(self) -> bool:
        """Heat and fan are held back."""
        return self.running_s is not None

    @property
    def due_in_s(self) -> float:
        """Time until heat and fan will be held back if both go on as they did, inf if that is not so [s]."""
        if self.running:
            return 0.0
        return max(EVERY_S - self.since_s, 0.0) if self.since_s > 0.0 and self.is_busy else math.inf

    @property
    def is_busy(self) -> bool:
        """Both have run for their share: where one hardly did, the ordinary balance sees the relay."""
        return min(self.heated_s, self.fanned_s) >= BUSY_SHARE * self.since_s


def follow(
    proof: RelayProof, dt_s: float, temp_air: float, heated: bool, fan: float, quiet: bool
) -> RelayProof:
    """Return the proof after one more step.

    dt_s : since the last one [s]; temp_air : [°C]
    heated, fan : what the board was told in it; fan : share of the time
    quiet : heater off and fan still for so long that the energy balance has judged
    """
    highest_c = -math.inf if heated or fan > 0.0 else max(proof.highest_c, temp_air)
    if quiet or temp_air <= highest_c - PASSED_K:
        return RelayProof()
    proof = replace(proof, highest_c=highest_c)
    if proof.running_s is not None:
        running_s = proof.running_s + dt_s
        return RelayProof() if running_s >= LONGEST_S else replace(proof, running_s=running_s)
    proof = replace(
        proof,
        since_s=proof.since_s + dt_s,
        heated_s=proof.heated_s + dt_s * heated,
        fanned_s=proof.fanned_s + dt_s * fan,
    )
    if proof.since_s < EVERY_S:
        return proof
    return replace(proof, running_s=0.0) if proof.is_busy else RelayProof()
