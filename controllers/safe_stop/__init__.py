"""Safe stop of the truck when no commands arrive."""
