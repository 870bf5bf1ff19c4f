"""Numbers of ticks in VictoriaMetrics: names of series; samples that are written to disk and read back.

No topic, no SQL and no rule about rigs is here: a caller brings names and samples, and gets samples.
"""
