"""Bags of other robots become runs of ours: their topics and types turned into those that a re-run reads."""
