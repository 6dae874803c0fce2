"""Standing up, lying down, sitting and getting up again, as sequences of joint commands."""
