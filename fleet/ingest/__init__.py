"""Messages of rigs become numbers, spans of stored ticks, states and events; what is missing is asked for.

What is heard is parsed by values alone; only `inbox` touches the broker and only `books` the database. No
page, no bundle and no judgement of a rig's health belongs here.
"""
