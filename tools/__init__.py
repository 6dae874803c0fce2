"""Programs for the people who develop the stack: benchmarks, studies, reports (not in the wheel)."""
