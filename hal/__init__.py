"""The robot: contract, value types, Go2-W facts, safety gate; simulators and hardware behind it."""
