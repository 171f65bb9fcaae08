"""The safe stop: what drives the truck when its commands stay away."""
