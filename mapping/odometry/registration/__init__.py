"""Engines that find the pose of a scan in the map of the scans before it."""
