"""A differential robot on four fixed wheels."""
