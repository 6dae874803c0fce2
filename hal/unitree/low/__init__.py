"""The Go2-W at its motors: a locomotion controller of ours in place of the robot's own motion service."""
