"""Planners of others in the place of ours."""
