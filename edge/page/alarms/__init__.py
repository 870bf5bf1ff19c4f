"""Alarms by message: ntfy, mail and webhook tell people who do not look at the page; and a sign of life.

What is an alarm is decided by values alone (`alarm_book`, `rig_watch`); `alarm_desk` brings time, disk and
network. Nothing here can give the rig an order.
"""
