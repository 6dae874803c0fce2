"""The Unitree Go2, on feet."""
