"""Limits that no configuration can widen. Changing one is a change of the code, with its review."""

TEMP_AIR_MAX_C = 60.0  # no plant and no glued seam of the box is made for more
TEMP_TRIP_MAX_C = 65.0  # the latch must come before the box's plastic parts soften
READING_AGE_MAX_S = 60.0  # heating on an older air temperature is heating blind
HEATER_RISE_MAX_PER_S = 1.0  # the full duty within a second is no limit at all
HEAT_HOUR_MAX_WH, HEAT_DAY_MAX_WH = 400.0, 9600.0  # of the largest heater that a board of this kind switches
FAN_PART_S = 5.0  # the fan is on for whole multiples of it, so that its relay does not chatter
VALVE_PULSE_MAX_S = 10.0  # one pulse; the board bounds it by itself as well
VALVE_DAY_MAX_S = 600.0  # what can be spilled in a day if soil and tank sensors lie
REFERENCE_MIN_C = 5.0
REFERENCE_MAX_C = 45.0
STEP_MIN_S = 1.0
STEP_MAX_S = 600.0
LEASE_S = 10.0  # outputs fall this long after the host's last word, a decision this long after its step
MAINTENANCE_MAX_MIN = 24 * 60.0
AIR_OFFSET_MAX_K = 5.0  # a larger one hides a broken sensor and moves every temperature limit with it
AIR_GAIN_MIN, AIR_GAIN_MAX = 0.9, 1.1  # 4 K at 40 °C
