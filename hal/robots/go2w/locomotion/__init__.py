"""Locomotion controllers that run on joint-level state: the model-based virtual model controller."""
