"""Pictures, films and a window of the simulated robot. Nothing that drives it imports this."""
