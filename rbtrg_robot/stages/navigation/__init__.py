"""The goal's life: what the navigator decides, and the words in which it tells."""
