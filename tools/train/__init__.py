"""Trains a blind velocity policy for the Go2-W: clones the model-based controller, then goes on with PPO on harder and
harder ground."""
