"""What a slope does to a robot that stands on wheels."""

import math

CREEP_SLOPE = math.radians(3.0)
"""[rad] Steeper ground pulls a robot that stands: it creeps against the control of its wheels."""
CREEP_SPEED = 0.3
"""[m/s] down a slope, up to which it is the slope; the operator is told, and it stays on its feet."""
