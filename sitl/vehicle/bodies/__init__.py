"""The bodies: the ideal one, and the models of `sitl.models` on a grid of time."""
