"""Vehicle meta-information: types and what changes them, who comes when, how they drive."""
