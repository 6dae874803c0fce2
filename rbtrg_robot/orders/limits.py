"""How often an order is repeated, and how long an answer may take [s]. Nothing is imported here: `stop` starts with
it."""

from __future__ import annotations

RESEND_PERIOD = 0.5
"""Between two sendings of a goal, of a question to the planner."""
REPEAT_PERIOD = 0.1
"""Between two sendings of a stop or of an order to the robot."""
ANSWER_LIMIT = 3.0
"""Without any answer."""
WORRY_AFTER = 1.0
"""Without the robot's answer to a stop, after which the operator is told."""
STOP_PATIENCE = 30.0
"""Until a stop that nobody confirms is given up."""
SETTLE_TIME = 1.0
"""Until an answer counts as one to the order and not as the state before."""
USE_HARDWARE = "use the hardware stop"
