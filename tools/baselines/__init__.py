"""Planners of others, for comparison: T-Hybrid (`t_hybrid`) and ART (`art`), written from their published behaviour."""
