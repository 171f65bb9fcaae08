"""Scenarios: events that conditions trigger, with vehicles that move on a plan.

`conditions` says when an event begins, `actions` what happens, `actors` moves the vehicles, and
`runner` plays the events in a running traffic. `docs/how_to/scenario.md` shows them in use.
"""
