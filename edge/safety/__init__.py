"""The safety supervisor: pure, and the last in front of the board for every writer.

Rules, what they remember between two ticks, thermal supervision and the proof of the heater's relay. Limits
that no configuration can widen stand in `edge.core.hard_limits`. Nothing here touches the world.
"""
