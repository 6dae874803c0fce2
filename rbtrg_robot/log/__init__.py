"""MCAP logs: writing, reading, replaying, measuring and filming them."""
