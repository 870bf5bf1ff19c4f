"""Every table, so that opening the database makes all of them. A new file of tables has a line here."""

from fleet.database import alarms, bundles, diagnoses, events, leases, people, rigs, twins

__all__ = ["alarms", "bundles", "diagnoses", "events", "leases", "people", "rigs", "twins"]
