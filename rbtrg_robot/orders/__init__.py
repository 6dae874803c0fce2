"""What an operator asks of the stack, repeated until it is answered. The commands and the console share it."""
