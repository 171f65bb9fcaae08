"""Validation of the emergency braking: UN R131, a careful driver, ordinary traffic."""
